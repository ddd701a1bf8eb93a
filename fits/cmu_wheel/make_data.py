"""Writes the rows without slip angle: ``python -m fits.cmu_wheel.make_data``."""

from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    for wheel in ("smooth", "grouser"):
        lines = (HERE / f"{wheel}_wheel.csv").read_text().splitlines()
        straight = [lines[0], *(line for line in lines[1:] if line.startswith("0,"))]
        (HERE / f"{wheel}_straight.csv").write_text("\n".join(straight) + "\n")


if __name__ == "__main__":
    main()
