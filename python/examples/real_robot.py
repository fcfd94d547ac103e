"""A real Universal Robots UR10 whose positions a laser tracker measured: identified from a ninth of them, judged at the others.

    python real_robot.py
"""

import pathlib

import numpy as np

import dbbd

path = pathlib.Path(__file__).resolve().parents[2] / "fixtures/real/ur10/random.csv"
table = np.loadtxt(path, delimiter=",", skiprows=1)
axes, places = table[:, :6], table[:, 6:]

# %% The sense in which each axis came to each pose: that of its last move
approach = np.zeros(axes.shape, int)
for pose in range(1, len(axes)):
    moved = np.sign(axes[pose] - axes[pose - 1])
    approach[pose] = np.where(moved != 0, moved, approach[pose - 1])

# %% Every ninth pose identifies the robot
seen = np.arange(len(axes)) % 9 == 0
result = dbbd.identify(
    robot=dbbd.Robot.load("ur10").with_tool([0, 0, 93]),
    positions_deg=axes[seen],
    positions_mm=places[seen],
    positions_approach=approach[seen],
)

# %% The predicted positions, in the tracker's frame by the poses that were seen
predicted, sd = result.predict_deg(axes, approach=approach)
start, end = predicted[seen].mean(0), places[seen].mean(0)
u, _, v = np.linalg.svd((predicted[seen] - start).T @ (places[seen] - end))
turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
error = np.linalg.norm((predicted - start) @ turn + end - places, axis=1)[~seen]
rms = np.sqrt(np.mean(error**2))
print(f"{len(error)} kept poses: mean 3-D error {error.mean():.3f} mm, rms {rms:.3f} mm, predicted {np.sqrt(np.mean(sd[~seen]**2)):.3f} mm")
assert error.mean() < 0.11
