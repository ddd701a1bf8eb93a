"""Write one sweep of a rig in each format that tirefit reads:
``python -m docs.samples.make_samples``."""

from pathlib import Path

import asammdf
import openpyxl
import pyarrow
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from tests.data.rig_file import DEG, METRIC_UNITS, TTC_COLUMNS, truth, ttc, tydex

HERE = Path(__file__).parent
ROWS = 80


def rows(frame):
    return zip(*frame.values(), strict=True)


def text(path, frame, separator, *above):
    """A text file: the lines above, then one line per row."""
    numbers = [separator.join(f"{x:.6g}" for x in row) for row in rows(frame)]
    path.write_text("\n".join([*above, *numbers]) + "\n", encoding="utf-8")


def in_kn(columns):
    """The quantities that a lateral fit uses; forces in kN, angles in degrees."""
    return {
        "time": columns["time"],
        "alpha": columns["alpha"] / DEG,
        "fy": columns["fy"] / 1e3,
        "fz": columns["fz"] / 1e3,
    }


def make():
    columns, units = truth(ROWS), {"time": "s", "alpha": "deg", "fy": "kN", "fz": "kN"}
    named = in_kn(columns)
    short = {name: columns[name] for name in named}
    text(HERE / "sweep.csv", short, ",", ",".join(short))
    heads = ";".join(f"{name} [{units[name]}]" for name in named)
    lines = ("Test rig 7", "Operator: A. N. Other", heads)
    text(HERE / "sweep_units.csv", named, ";", *lines)
    heads = "\t".join(TTC_COLUMNS), "\t".join(METRIC_UNITS)
    text(HERE / "ttc.dat", ttc(columns), "\t", "Round 0", *heads)
    (HERE / "sweep.tdx").write_text("\n".join(tydex(columns)) + "\n")
    savemat(HERE / "sweep.mat", short, do_compression=True)
    fields = [
        pyarrow.field(name, pyarrow.float64(), metadata={"unit": units[name]}) for name in named
    ]
    arrays = [pyarrow.array(x) for x in named.values()]
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    parquet.write_table(table, HERE / "sweep.parquet")
    book = openpyxl.Workbook()
    book.active.append(list(named))
    book.active.append(list(units.values()))
    for row in rows(named):
        book.active.append([float(x) for x in row])
    book.save(HERE / "sweep.xlsx")
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(
            [
                asammdf.Signal(x, columns["time"], name=name, unit=units[name])
                for name, x in named.items()
                if name != "time"
            ]
        )
        mdf.save(HERE / "sweep.mf4", overwrite=True)
    bag(HERE / "bag", short)


def bag(path, frame):
    """A ROS 2 bag (MCAP) with a topic of numbers for each quantity."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    number = store.types["std_msgs/msg/Float64"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            name: writer.add_connection(f"/{name}", number.__msgtype__, typestore=store)
            for name in frame
            if name != "time"
        }
        for row, time in enumerate(frame["time"]):
            for name, topic in topics.items():
                raw = store.serialize_cdr(number(frame[name][row]), number.__msgtype__)
                writer.write(topic, round(1e9 * (1000 + time)), raw)
    next(path.glob("*.mcap")).rename(HERE / "sweep.mcap")
    (path / "metadata.yaml").unlink()
    path.rmdir()


if __name__ == "__main__":
    make()
