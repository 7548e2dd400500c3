"""An analysis as tables of pandas: units in the names of the columns, and in `attrs["units"]`.

`attrs["frame"]` says in which axes vectors are: the world's, whose x and y lie in the table and whose z points up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ..files.throw_records import BOUNCE_COLUMNS, POSITION_COLUMNS, QUATERNION_COLUMNS, SIGMA_COLUMNS, bounce_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..fitting.results import Effect, Parameter
    from ..model.throw import Impact
    from ..tracking.track import Track

_SUFFIXES = {
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_s_per_m": "s/m",
    "_kg_m2": "kg m²",
    "_per_m": "1/m",
    "_N_s": "N s",
    "_rad": "rad",
    "_hz": "Hz",
    "_m": "m",
    "_s": "s",
    "_J": "J",
}
"""Units by the ends of names, the longer first."""


def unit_of(name: str) -> str:
    """The unit that a name ends with; "1" for a number without unit.

    >>> unit_of("normal_velocity_after_m_s"), unit_of("chi")
    ('m/s', '1')
    """
    return next((unit for suffix, unit in _SUFFIXES.items() if name.endswith(suffix)), "1")


def frames_table(track: Track) -> pd.DataFrame:
    """One row a frame: time, position of the centroid, quaternion from body to world axes, standard errors, status."""
    variances = np.einsum("kii->ki", track.covariance)
    with np.errstate(invalid="ignore"):
        sigmas = np.where(variances >= 0.0, np.sqrt(variances), np.nan)
    columns: dict[str, Any] = {"frame": track.frame, "t_s": track.time_s}
    columns |= dict(zip(POSITION_COLUMNS, track.position_m.T, strict=True))
    columns |= dict(zip(QUATERNION_COLUMNS, track.quaternion.T, strict=True))
    columns |= dict(zip(SIGMA_COLUMNS, sigmas.T, strict=True))
    return _with_units(pd.DataFrame({**columns, "status": track.status.astype(str)}).set_index("frame"))


def bounces_table(impacts: Sequence[Impact]) -> pd.DataFrame:
    """One row an impact, numbered from 1; columns as in `bounces.csv`."""
    return _with_units(pd.DataFrame(bounce_rows(impacts), columns=list(BOUNCE_COLUMNS)).set_index("bounce"))


def parameters_table(parameters: Mapping[str, Parameter]) -> pd.DataFrame:
    """One row a parameter: value, interval and its level, unit, whether the data moved it, whether it lies on a bound."""
    rows = {name: {**asdict(parameter), "unit": unit_of(name)} for name, parameter in parameters.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")


def effects_table(chosen: Sequence[str], considered: Sequence[Effect]) -> pd.DataFrame:
    """One row an effect: whether it is in the model, the evidence in units of log-likelihood, and why it was refused."""
    rows: list[dict[str, Any]] = [
        {"effect": name, "accepted": True, "evidence": None, "why_not": None} for name in chosen
    ]
    rows += [{"effect": e.name, "accepted": False, "evidence": e.evidence, "why_not": e.why_not} for e in considered]
    return pd.DataFrame(rows, columns=["effect", "accepted", "evidence", "why_not"]).set_index("effect")


def matrix_table(matrix: NDArray[np.float64], names: Sequence[str]) -> pd.DataFrame:
    """A covariance with the names of its rows and columns."""
    return _with_units(pd.DataFrame(matrix, index=list(names), columns=list(names)))


def _with_units(table: pd.DataFrame) -> pd.DataFrame:
    table.attrs = {"units": {str(name): unit_of(str(name)) for name in table.columns}, "frame": "world"}
    return table
