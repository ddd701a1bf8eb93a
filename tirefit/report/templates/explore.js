// Values are in SI units; only what is shown is in degrees and kPa.
const COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"];
const SHOWN = {  // input: name, symbol, unit, factor to it, difference of a row near the setting
  fz: ["load", "F<sub>z</sub>", "N", 1, x => 0.1 * Math.abs(x)],
  alpha: ["slip angle", "α", "°", 180 / Math.PI, () => Math.PI / 180],
  kappa: ["slip", "κ", "", 1, () => 0.02],
  gamma: ["camber", "γ", "°", 180 / Math.PI, () => Math.PI / 180],
  pressure: ["pressure", "p", "kPa", 1e-3, x => 0.05 * x],
  v: ["speed", "v", "m/s", 1, x => 0.2 * Math.abs(x)],
};
const FORCES = {fx: ["F<sub>x</sub>", "N", "kappa"], fy: ["F<sub>y</sub>", "N", "alpha"],
  mz: ["M<sub>z</sub>", "N m", "alpha"]};
const SLIP_POINTS = 60, LOAD_POINTS = 15;  // on each side of zero; of the curves over load
const MOST_POINTS = 400;  // measured ones: with 2,600 a figure was redrawn ten times as slowly
const setting = {}, names = Object.keys(SHOWN).filter(name => E.inputs[name]);
for (const name of names) setting[name] = E.inputs[name][2];
E.tires.forEach((tire, k) => Object.assign(tire, {program: PROGRAMS[k], color: COLORS[k],
  // Plotly would read marks in a name.
  said: E.tires.length > 1 ? `${tire.label.replace(/[<>&%]/g, " ")}: ` : ""}));

const axis = name => `${SHOWN[name][0]} ${SHOWN[name][1]} ${SHOWN[name][2] && `[${SHOWN[name][2]}]`}`;
const text = (name, x) => `${+(x * SHOWN[name][3]).toPrecision(4)} ${SHOWN[name][2]}`.trim();

function force(tire, name, change, p = tire.theta) {
  const at = {v: 10, gamma: 0, pressure: 0, ...setting, ...change};
  return tire.program(at.kappa, at.alpha, at.fz, at.v, at.gamma, at.pressure, p)[tire.outputs.indexOf(name)];
}

// Values (n,) that a function of the parameters gives, and half widths of their 95 % intervals.
function spread(tire, values) {
  const centre = values(tire.theta), square = centre.map(() => 0);
  tire.steps.forEach(step => {
    const up = values(tire.theta.map((x, i) => x + step[i]));
    values(tire.theta.map((x, i) => x - step[i]))
      .forEach((x, i) => { square[i] += (up[i] - x) ** 2; });
  });
  return {centre, half: square.map(x => tire.scale * Math.sqrt(x)), known: tire.steps.length > 0};
}

// Slips of a curve, closer near zero, where it bends.
function slips(name) {
  const side = end => Array.from({length: SLIP_POINTS}, (_, k) => (k + 1) / SLIP_POINTS)
    .map(u => end * u * (0.2 + 0.8 * u));
  return [...side(E.inputs[name][0]).reverse(), 0, ...side(E.inputs[name][1])];
}

function loads() {
  const [low, high] = E.inputs.fz;
  return Array.from({length: LOAD_POINTS}, (_, k) => low + (high - low) * k / (LOAD_POINTS - 1));
}

// Slope at zero slip, and largest force over the load, both without sign, at given loads.
function stiffness(tire, name, at) {
  const slip = FORCES[name][2], step = 1e-5;
  return spread(tire, p => at.map(fz => Math.abs(
    force(tire, name, {fz, [slip]: step}, p) - force(tire, name, {fz, [slip]: -step}, p)) / (2 * step)));
}
function peak(tire, name, at) {
  const slip = FORCES[name][2], grid = slips(slip).sort((a, b) => Math.abs(a) - Math.abs(b) || b - a);
  const where = at.map(fz => grid.reduce((best, x) => {
    const size = Math.abs(force(tire, name, {fz, [slip]: x}));
    return size > best[0] * (1 + 1e-6) ? [size, x] : best;  // the first slip at which all slides
  }, [0, 0])[1]);
  const found = spread(tire, p => at.map((fz, i) => Math.abs(force(tire, name, {fz, [slip]: where[i]}, p) / fz)));
  return {...found, where};
}

// Tires whose data do not contain the setting of an input, with the reason.
function beyond(name) {
  const step = (E.inputs[name][1] - E.inputs[name][0]) / 200, x = setting[name];
  return E.tires.filter(({ranges: {[name]: range}}) => range && (x < range[0] - step || x > range[1] + step))
    .map(tire => `${SHOWN[name][0]} ${text(name, x)} is outside the data of ${tire.label} (${tire.ranges[name].map(x => text(name, x)).join(" to ")})`);
}

// Why a whole figure is outside the data: a setting, or an input that it varies and the data do not.
function outside(varied) {
  return names.flatMap(name => !varied.includes(name) ? beyond(name)
    : E.tires.filter(({ranges: {[name]: range}}) => range && range[0] === range[1])
      .map(tire => `the data of ${tire.label} have only ${SHOWN[name][0]} ${text(name, tire.ranges[name][0])}`));
}

function shading(varied, slip) {
  const area = (x0, x1) => ({type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1,
    fillcolor: "rgba(110,110,110,.17)", line: {width: 0}, layer: "below"});
  const factor = slip ? SHOWN[slip][3] : 1, [low, high] = slip ? E.inputs[slip] : [0, 1];
  if (outside(varied).length) return [{...area(0, 1), xref: "paper"}];
  const known = slip ? E.tires.map(t => t.ranges[slip]).filter(r => r) : [];
  const least = Math.max(low, ...known.map(r => r[0])), most = Math.min(high, ...known.map(r => r[1]));
  if (least > most) return [{...area(0, 1), xref: "paper"}];
  return [area(low * factor, least * factor), area(most * factor, high * factor)].filter(a => a.x1 > a.x0);
}

function rowsNear(varied, force) {
  const near = [];
  for (let i = 0; i < (E.rows[force] || []).length; i++) {
    if (E.rows[force][i] !== null && names.every(n => varied.includes(n) || !E.rows[n] || E.rows[n][i] === null
      || Math.abs(E.rows[n][i] - setting[n]) <= SHOWN[n][4](setting[n]))) near.push(i);
  }
  const every = Math.ceil(near.length / MOST_POINTS);
  return near.filter((_, k) => k % every === 0);
}

function curve(tire, x, found, name, unit, dash = "solid") {
  const line = {mode: "lines", x, legendgroup: tire.label, hoverinfo: "skip", showlegend: false, line: {width: 0}};
  const size = k => found.half.map((h, i) => found.centre[i] + k * h);
  const band = found.known ? [{...line, y: size(-1)},
    {...line, y: size(1), fill: "tonexty", fillcolor: tire.color + "33"}] : [];
  return [...band, {...line, y: found.centre, name: tire.label, customdata: found.half, hoverinfo: undefined,
    line: {color: tire.color, width: 2.5, dash},
    hovertemplate: `${tire.said}${name} %{y:.4~g}` +
      (found.known ? " ± %{customdata:.2~g}" : "") + ` ${unit}<extra></extra>`}];
}

// A measured force, moved from the inputs of its row to the sliders as the first tire would change.
function moved(varied, name, i) {
  const tire = E.tires.find(t => t.outputs.includes(name)), own = {}, there = {};
  for (const n of names) {
    const x = E.rows[n] ? E.rows[n][i] : ["kappa", "alpha", "gamma"].includes(n) ? 0 : null;
    own[n] = x === null ? setting[n] : x;
    if (varied.includes(n)) there[n] = own[n];
  }
  return E.rows[name][i] + force(tire, name, there) - force(tire, name, own);
}

function points(varied, near, x, y, label, customdata) {
  return {mode: "markers", x: near.map(x), y: near.map(y), customdata: near.map(customdata), showlegend: false,
    hovertemplate: `measured ${label}<extra></extra>`, marker: {color: "#222", size: 5, opacity: 0.45}};
}

function forcePanel(name) {
  const [symbol, unit, slip] = FORCES[name], x = slips(slip), factor = SHOWN[slip][3], data = [];
  for (const tire of E.tires.filter(t => t.outputs.includes(name)))
    data.push(...curve(tire, x.map(s => s * factor),
      spread(tire, p => x.map(s => force(tire, name, {[slip]: s}, p))), symbol, unit));
  if (E.rows[slip]) data.unshift(points([slip], rowsNear([slip], name), i => E.rows[slip][i] * factor,
    i => moved([slip], name, i), `%{customdata:.4~g} ${unit}`, i => E.rows[name][i]));
  return {data, varied: [slip], slip, x: axis(slip), y: `${symbol} [${unit}]`};
}

function ellipse() {
  const data = [], [low, high] = E.inputs.alpha, end = Math.max(-low, high), grid = slips("kappa");
  const varied = ["kappa", "alpha"];
  if (E.rows.fx && E.rows.fy) data.push(points(varied, rowsNear(varied, "fx").filter(i => E.rows.fy[i] !== null),
    i => moved(varied, "fx", i), i => moved(varied, "fy", i),
    "F<sub>x</sub> %{customdata[0]:.4~g} N, F<sub>y</sub> %{customdata[1]:.4~g} N", i => [E.rows.fx[i], E.rows.fy[i]]));
  for (const tire of E.tires.filter(t => t.outputs.includes("fx") && t.outputs.includes("fy"))) {
    const at = [-1, -0.5, -0.2, 0, 0.2, 0.5, 1].flatMap(share =>
      [...grid.map(kappa => ({kappa, alpha: share * end})), null]);
    const of = name => at.map(change => change && force(tire, name, change));
    data.push({mode: "lines", x: of("fx"), y: of("fy"), line: {color: tire.color, width: 1.5}, showlegend: false,
      customdata: at.map(c => c && `κ ${text("kappa", c.kappa)}, α ${text("alpha", c.alpha)}`),
      hovertemplate: tire.said + "%{customdata}: F<sub>x</sub> %{x:.4~g} N, F<sub>y</sub> %{y:.4~g} N<extra></extra>"});
    data.push({mode: "markers", x: [force(tire, "fx", {})], y: [force(tire, "fy", {})], showlegend: false,
      marker: {color: tire.color, size: 13, line: {color: "#fff", width: 2}},
      hovertemplate: tire.said + "at the sliders: F<sub>x</sub> %{x:.4~g} N, F<sub>y</sub> %{y:.4~g} N<extra></extra>"});
  }
  return {data, varied, x: "F<sub>x</sub> [N]", y: "F<sub>y</sub> [N]", equal: true};
}

function overLoad(quantity, symbol, units, title) {
  const x = loads(), data = [];
  for (const tire of E.tires) for (const [k, name] of ["fx", "fy"].entries())
    if (tire.outputs.includes(name)) data.push(...curve(tire, x, quantity(tire, name, x),
      symbol + ["<sub>x</sub>", "<sub>y</sub>"][k], units[k], ["solid", "dash"][k]));
  return {data, varied: ["fz"], slip: "fz", x: axis("fz"), y: title, zero: true};
}

const PANELS = {
  fx: ["Longitudinal force", () => forcePanel("fx")],
  fy: ["Lateral force", () => forcePanel("fy")],
  mz: ["Aligning moment", () => forcePanel("mz")],
  ellipse: ["Friction ellipse (dot: at the sliders)", ellipse],
  stiffness: ["Slip stiffness of F<sub>x</sub> (line) and F<sub>y</sub> (dashed)",
    () => overLoad(stiffness, "C", ["N", "N/rad"], "C<sub>x</sub> [N], C<sub>y</sub> [N/rad]")],
  peak: ["Peak of F<sub>x</sub> (line) and F<sub>y</sub> (dashed) over F<sub>z</sub>", () => overLoad(peak, "μ", ["", ""], "peak / F<sub>z</sub>")],
};

function drawPanel(id) {
  const panel = PANELS[id][1](), touch = matchMedia("(pointer: coarse)").matches;
  const layout = {margin: {l: 62, r: 8, t: 6, b: 42}, font: {size: 13}, hovermode: panel.equal ? "closest" : "x unified",
    shapes: shading(panel.varied, panel.slip), dragmode: touch ? false : "zoom", uirevision: "kept",
    xaxis: {title: {text: panel.x}, zeroline: true, zerolinecolor: "#999"},
    yaxis: {title: {text: panel.y}, zerolinecolor: "#999", rangemode: panel.zero ? "tozero" : "normal"}};
  if (panel.equal) Object.assign(layout.yaxis, {scaleanchor: "x"});
  else layout.xaxis.range = E.inputs[panel.slip].slice(0, 2).map(x => x * SHOWN[panel.slip][3]);
  Plotly.react(id, panel.data, layout, {responsive: true, displayModeBar: false});
  document.getElementById(`${id}-note`).textContent = outside(panel.varied).join("; ");
}

function answer() {
  const cell = ({centre: [x], half: [h], known}) => known && h > 0
    ? `${x.toFixed(Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(h)))))} ± ${+h.toPrecision(2)}` : `${+x.toPrecision(3)}`;
  const rows = E.tires.map(tire => [tire.label, ...["fx", "fy"].flatMap(name => {
    if (!tire.outputs.includes(name)) return ["-", "-", "-"];
    const top = peak(tire, name, [setting.fz]), slip = FORCES[name][2];
    return [cell(top), text(slip, +top.where[0].toPrecision(2)), cell(stiffness(tire, name, [setting.fz]))];
  })]);
  document.getElementById("answer").replaceChildren(...rows.map((row, k) => {
    const line = document.createElement("tr");
    row.forEach(words => { line.insertCell().textContent = words; });
    line.cells[0].insertAdjacentHTML("afterbegin", `<span class="key" style="background:${COLORS[k]}"></span>`);
    return line;
  }));
}

// Only figures on the screen are drawn at once, the others when they come there.
const stale = new Set();
function drawSeen() {
  for (const id of stale) {
    const {top, bottom} = document.getElementById(id).getBoundingClientRect();
    if (bottom > 0 && top < innerHeight) {
      stale.delete(id);
      drawPanel(id);
    }
  }
}

function draw() {
  answer();
  for (const id of Object.keys(PANELS)) if (document.getElementById(id)) stale.add(id);
  drawSeen();
}

let waiting = 0;
function slider(name) {
  const [low, high] = E.inputs[name], label = document.createElement("label"), input = document.createElement("input");
  const value = document.createElement("output");
  const show = () => {
    value.textContent = text(name, setting[name]);
    label.className = beyond(name).length ? "outside" : "";
  };
  Object.assign(input, {type: "range", id: `set-${name}`, min: low, max: high, step: (high - low) / 200});
  input.value = setting[name];
  input.addEventListener("input", () => {
    setting[name] = +input.value;
    show();
    cancelAnimationFrame(waiting);
    waiting = requestAnimationFrame(draw);
  });
  label.append(`${SHOWN[name][0]} `, value, input);
  show();
  return label;
}

function build() {
  document.getElementById("sliders").replaceChildren(...names.map(slider));
  for (const [id, [title]] of Object.entries(PANELS)) {
    const has = f => E.tires.some(t => t.outputs.includes(f));
    if (id in FORCES ? !has(id) : id === "ellipse" && !(has("fx") && has("fy"))) continue;
    document.getElementById("panels").insertAdjacentHTML("beforeend",
      `<div><h2>${title}</h2><div id="${id}" class="plot"></div><p class="note" id="${id}-note"></p></div>`);
  }
  draw();
  for (const what of ["scroll", "resize"]) addEventListener(what, () => requestAnimationFrame(drawSeen), {passive: true});
}
build();
