"""What the tests share: the repository, and its paper experiment as arrays."""

import csv
import pathlib

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


def numbers(path, names):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(row[name]) for name in names] for row in rows])


@pytest.fixture(scope="session")
def paper():
    """The paper's experiment as the arguments of `identify`."""
    folder = ROOT / "examples" / "paper"
    axes = [f"a{axis}_deg" for axis in range(1, 7)]
    table = numbers(folder / "observations.csv", ["index", "centre", *axes, "length_mm"])
    return {
        "axes_deg": table[:, 2:8],
        "lengths_mm": table[:, 8],
        "ball": table[:, 1].astype(int),
        "index": table[:, 0].astype(int),
        "balls_mm": numbers(folder / "centres.csv", ["x_mm", "y_mm", "z_mm"]),
    }
