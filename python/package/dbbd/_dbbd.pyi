from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
__all__ = [
    "Capture",
    "Check",
    "Plan",
    "Result",
    "Robot",
    "__version__",
    "_main",
    "check",
    "identify",
    "plan",
    "request",
    "request_json",
    "simulate",
]

_Path = str | PathLike[str]
_Float = NDArray[np.float64]
_Int = NDArray[np.int64]
_Frame = Literal["ball", "flange"]
_Dict = dict[str, Any]

@final
class Robot:
    @staticmethod
    def load(name_or_path: _Path, *, tool_mm: Sequence[float] | None = None) -> Robot: ...
    @staticmethod
    def built_in() -> list[str]: ...
    @property
    def name(self) -> str: ...
    @property
    def limits_deg(self) -> _Float: ...
    @property
    def tool_mm(self) -> _Float: ...
    @property
    def identified(self) -> bool: ...
    def nominal(self) -> Robot: ...
    def with_tool(self, tool_mm: Sequence[float]) -> Robot: ...
    def drawn(self, seed: int, scale: float = 1.0) -> Robot: ...
    def fk_deg(self, q: ArrayLike, *, frame: _Frame = "ball") -> _Float: ...
    def fk_rad(self, q: ArrayLike, *, frame: _Frame = "ball") -> _Float: ...
    def ik_deg(self, pose: ArrayLike, near: ArrayLike | None = None) -> _Float: ...
    def ik_rad(self, pose: ArrayLike, near: ArrayLike | None = None) -> _Float: ...
    def jacobian_deg(self, q: ArrayLike) -> _Float: ...
    def jacobian_rad(self, q: ArrayLike) -> _Float: ...
    def save(self, path: _Path) -> None: ...
    def to_urdf(self, path: _Path) -> None: ...
    def patch_urdf(self, users_urdf: _Path, *, joints: Sequence[str] = ...) -> tuple[str, list[_Dict]]: ...

@final
class Capture:
    @staticmethod
    def open(path: _Path) -> Capture: ...
    def samples(self) -> dict[str, NDArray[Any]]: ...
    def events(self) -> list[_Dict]: ...
    def lengths(self) -> tuple[dict[str, Any], list[_Dict]]: ...
    @property
    def plan(self) -> Plan | None: ...
    @property
    def findings(self) -> list[_Dict]: ...

@final
class Plan:
    @staticmethod
    def read(path: _Path) -> Plan: ...
    @property
    def axes_deg(self) -> _Float: ...
    @property
    def ball(self) -> _Int: ...
    @property
    def balls_mm(self) -> _Float: ...
    @property
    def findings(self) -> list[_Dict]: ...
    def rows(self) -> dict[str, list[Any]]: ...
    def header(self) -> _Dict: ...
    def write(self, directory: _Path) -> None: ...

@final
class Result:
    @property
    def parameters(self) -> list[_Dict]: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def covariance(self) -> _Float: ...
    @property
    def findings(self) -> list[_Dict]: ...
    @property
    def has_warnings(self) -> bool: ...
    @property
    def robot(self) -> Robot: ...
    def to_json(self) -> str: ...
    def to_dict(self) -> _Dict: ...
    def predict_deg(self, q: ArrayLike, *, approach: ArrayLike | None = None) -> tuple[_Float, _Float]: ...
    def covariance_deg(self, q: ArrayLike, *, approach: ArrayLike | None = None) -> _Float: ...

@final
class Check:
    @property
    def decision(self) -> Literal["pass", "fail", "undecided", "unchanged", "changed"]: ...
    @property
    def changes(self) -> list[_Dict]: ...
    @property
    def updated(self) -> Robot | None: ...
    @property
    def findings(self) -> list[_Dict]: ...
    def to_dict(self) -> _Dict: ...

def identify(
    axes_deg: ArrayLike | None = None,
    lengths_mm: ArrayLike | None = None,
    ball: ArrayLike | None = None,
    *,
    robot: Robot,
    balls_mm: ArrayLike | None = None,
    positions_deg: ArrayLike | None = None,
    positions_mm: ArrayLike | None = None,
    target: ArrayLike | None = None,
    positions_sigma_mm: ArrayLike | None = None,
    positions_approach: ArrayLike | None = None,
    sigma_mm: ArrayLike | None = None,
    bar: ArrayLike | None = None,
    approach: ArrayLike | None = None,
    index: ArrayLike | None = None,
    payload: str | Sequence[str] | None = None,
    force_n: ArrayLike | None = None,
    t_s: ArrayLike | None = None,
    tool_mm: Sequence[float] | None = None,
    estimate: str | None = None,
    hold: str | None = None,
    prior: Literal["none", "datasheet", "posterior"] | Mapping[str, float] | None = None,
    model: Literal["joints", "geometric"] = "joints",
    bar_u_mm: float | None = None,
    folds: int | None = None,
    monte_carlo: int | None = None,
    workspace_deg: ArrayLike | None = None,
    measured: str | None = None,
    temperature_c: float | None = None,
) -> Result: ...
def check(
    axes_deg: ArrayLike,
    lengths_mm: ArrayLike,
    ball: ArrayLike,
    *,
    robot: Robot,
    balls_mm: ArrayLike,
    sigma_mm: ArrayLike | None = None,
    bar: ArrayLike | None = None,
    approach: ArrayLike | None = None,
    index: ArrayLike | None = None,
    payload: str | Sequence[str] | None = None,
    force_n: ArrayLike | None = None,
    t_s: ArrayLike | None = None,
    tolerance_mm: float | None = None,
    risk: float | None = ...,  # 0.05
    tool_repeat_mm: float = ...,  # 0.01
    ball_repeat_mm: float | None = None,
    bar_u_mm: float | None = None,
    workspace_deg: ArrayLike | None = None,
    measured: str | None = None,
    temperature_c: float | None = None,
) -> Check: ...
def plan(job: _Path, *, robot: Robot | None = None) -> Plan: ...
def request(request: Mapping[str, Any] | str) -> _Dict: ...
def request_json(request: Mapping[str, Any] | str) -> str: ...
def simulate(
    axes_deg: ArrayLike,
    ball: ArrayLike,
    *,
    robot: Robot,
    balls_mm: ArrayLike,
    bar_mm: float,
    stroke_mm: Sequence[float] = ...,  # any
    noise_um: float = 1.0,
    resolution_um: float = 0.1,
    repeatability_um: float = 0.0,
    backlash_deg: Sequence[float] = ...,  # none
    seed: int = 1,
) -> _Float: ...
def _main(arguments: Sequence[str], launcher: Sequence[str]) -> int: ...
