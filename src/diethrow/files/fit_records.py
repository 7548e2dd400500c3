"""`fit.json`: the parameters of a fit with their intervals, the law of impact, the release state, effects and messages.

What was not determined is null, never NaN. `commands` put the same tables into the files of joint fits and predictions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fitting.results import (
    STATE_NAMES,
    USUAL_CHOICES,
    Choices,
    Effect,
    Fit,
    Misfit,
    Parameter,
    ParameterCovariance,
)
from ..model.errors import InputError
from ..model.laws import CoulombImpact, FrictionBySpeed, Restitution, RestitutionBySpeed, SmoothImpact
from ..model.rotations import euler_from_quat, matrix_from_quat
from ..model.throw import State
from .csv_and_json import read_json, write_json

Array = NDArray[np.float64]

NOT_A_FIT = "wanted the fit.json that a fit writes"
RESTITUTION_MEANINGS: dict[Restitution, str] = {
    "stronge": "restitution chi by energy (Stronge)",
    "poisson": "restitution chi by impulse (Poisson)",
    "newton": "restitution chi by normal velocity (Newton)",
    "algebraic": "restitution chi by normal velocity, friction by the impulse as a whole (Chatterjee and Ruina)",
}


def write_fit(path: Path, fit: Fit) -> None:
    """Write `fit.json`."""
    write_json(path, fit_tables(fit))


def fit_tables(fit: Fit) -> dict[str, Any]:
    """A fit in the form of its JSON."""
    return {
        "parameters": parameters_table(fit.parameters),
        **({"variance_shares": fit.variance_shares} if fit.variance_shares else {}),
        "law": law_table(fit.parameters, fit.restitution),
        "initial": None if fit.initial is None else state_table(fit.initial, fit.initial_covariance),
        "effects": {
            "chosen": list(fit.chosen),
            "considered": effects_table(fit.considered),
        },
        **({} if fit.covariance is None else {"covariance": _covariance_table(fit.covariance_names, fit.covariance)}),
        "model": {"vertices": list(fit.vertices), "fitted_until_s": fit.fitted_until_s},
        "choices": asdict(fit.choices),
        "bounces_fitted": fit.bounces_fitted,
        "residual_rms": fit.residual_rms,
        "landed_face": fit.landed_face,
        "face_odds": None if fit.face_odds is None else {str(face): odds for face, odds in fit.face_odds.items()},
        "messages": list(fit.messages),
    }


def parameters_table(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Parameters in the form of their JSON, by name."""
    return {name: asdict(parameter) for name, parameter in parameters.items()}


def effects_table(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """Effects in the form of their JSON."""
    return [asdict(effect) for effect in effects]


def law_table(parameters: Mapping[str, Parameter], restitution: Restitution = "stronge") -> dict[str, Any]:
    """The law of impact that parameters of these names belong to: in words, and the constants that no parameter holds."""
    friction = "mu" in parameters
    chi_exponent = RestitutionBySpeed(SmoothImpact(1.0), 1.0).exponent if "chi_fade_s_per_m" in parameters else None
    mu_fades = "mu_fade_s_per_m" in parameters and friction
    mu_exponent = FrictionBySpeed(CoulombImpact(1.0, 1.0), 1.0).exponent if mu_fades else None
    words = ["Rigid impact of a corner"]
    if friction:
        meaning = RESTITUTION_MEANINGS[restitution]
        words.append(f"Coulomb friction mu integrated along the normal impulse, {meaning}")
    else:
        words.append("no friction, the normal velocity u goes to -chi u")
    if chi_exponent is not None:
        words.append(f"chi falls with the normal speed u as (1 + u chi_fade_s_per_m)^-{chi_exponent:g}")
    if mu_exponent is not None:
        words.append(f"mu falls as (1 + u mu_fade_s_per_m)^-{mu_exponent:g}, and is mu where the contact lasts")
    return {
        "words": "; ".join(words) + ".",
        "friction": "coulomb" if friction else "none",
        "restitution": restitution if friction else "newton",
        "chi_fade_exponent": chi_exponent,
        "mu_fade_exponent": mu_exponent,
    }


def state_table(state: State, covariance: Array | None = None) -> dict[str, Any]:
    """A state in the form of its JSON, with the paper's Euler angles and body-frame spin; covariance (12, 12) or null."""
    return {
        "t_s": state.time_s,
        "position_m": state.position_m,
        "quaternion_wxyz": state.quaternion,
        "velocity_m_s": state.velocity_m_s,
        "omega_rad_s": state.omega_rad_s,
        "euler_rad": euler_from_quat(state.quaternion),
        "omega_body_rad_s": matrix_from_quat(state.quaternion).T @ state.omega_rad_s,
        "covariance": covariance,
    }


def read_parameters(path: Path) -> tuple[dict[str, Parameter], Restitution]:
    """The parameters and the kind of restitution in a `fit.json`, of one throw or of many.

    Raises FileNotFoundError, and ValueError with the file and the entry for what is not a fit, for a parameter that was not
    determined, and for a law that differs from the law that these parameters have in this version.
    """
    data = read_json(path)
    try:
        parameters = {str(name): Parameter(**values) for name, values in data["parameters"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a fit ({error!r}); {NOT_A_FIT}") from error
    for name, parameter in parameters.items():
        if not isinstance(parameter.value, (int, float)) or not math.isfinite(parameter.value):
            raise InputError(f"{path}: parameters.{name}.value = {parameter.value}; wanted a fit that determined it")
    law = data.get("law", law_table(parameters))
    if not isinstance(law, dict):
        raise InputError(f"{path}: law = {law}; wanted a table")
    found = law.get("restitution")
    kind: Restitution = found if "mu" in parameters and found in RESTITUTION_MEANINGS else "stronge"
    for key, wanted in law_table(parameters, kind).items():
        if key != "words" and law.get(key) != wanted:
            raise InputError(f"{path}: law.{key} = {law.get(key)}; wanted {wanted}")
    return parameters, kind


def _covariance_table(names: Sequence[str], matrix: Array) -> dict[str, Any]:
    return {"names": list(names), "matrix": matrix}


def errors_tables(covariance: ParameterCovariance, misfit: Misfit) -> dict[str, Any]:
    """The errors of a joint fit in the form of its JSON."""
    return {
        "covariance": _covariance_table(covariance.names, covariance.matrix),
        "misfit": {
            "t_s": misfit.time_s,
            "position_m": misfit.position_m,
            "rotation_rad": misfit.rotation_rad,
        },
    }


def read_errors(path: Path) -> tuple[ParameterCovariance | None, Misfit | None]:
    """The covariance of the parameters in a `fit.json`, and the misfit of the law in that of many throws; None where it has none.

    Raises ValueError, with the file, for tables that do not belong together."""
    data = read_json(path)
    try:
        covariance, misfit = data.get("covariance"), data.get("misfit")
        found = None
        if covariance is not None:
            names, matrix = covariance["names"], np.array(covariance["matrix"], float)
            if matrix.shape != (len(names),) * 2 or not np.isfinite(matrix).all():
                raise InputError(f"covariance of shape {matrix.shape} for {len(names)} names")
            rows = [k for k, name in enumerate(names) if name not in STATE_NAMES]
            found = ParameterCovariance(tuple(names[k] for k in rows), matrix[np.ix_(rows, rows)])
        if misfit is None:
            return found, None
        columns = [np.array(misfit[name], float) for name in ("t_s", "position_m", "rotation_rad")]
        if len({column.shape for column in columns}) > 1 or columns[0].ndim != 1 or (np.diff(columns[0]) < 0.0).any():
            raise InputError("misfit without as many positions and rotations as times, in order")
        return found, Misfit(*columns)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}; {NOT_A_FIT}") from error


def read_fit(path: Path) -> Fit:
    """The fit of `fit.json`, without its throw. Raises FileNotFoundError, and ValueError for what is not a fit."""
    data = read_json(path)
    try:
        initial = data["initial"]
        return Fit(
            parameters={name: Parameter(**values) for name, values in data["parameters"].items()},
            initial=None if initial is None else _state(initial),
            initial_covariance=None if initial is None else _matrix(initial["covariance"]),
            chosen=tuple(data["effects"]["chosen"]),
            considered=tuple(Effect(**values) for values in data["effects"]["considered"]),
            bounces_fitted=data["bounces_fitted"],
            residual_rms=data["residual_rms"],
            landed_face=data["landed_face"],
            face_odds=None if data["face_odds"] is None else {int(f): odds for f, odds in data["face_odds"].items()},
            messages=tuple(data["messages"]),
            throw=None,
            restitution=data["law"]["restitution"] if data["law"]["friction"] != "none" else "stronge",
            variance_shares=data.get("variance_shares", {}),
            choices=_choices(data["choices"]) if "choices" in data else USUAL_CHOICES,
            covariance=_matrix(data.get("covariance", {}).get("matrix")),
            vertices=tuple(data.get("model", {}).get("vertices", ())),
            fitted_until_s=data.get("model", {}).get("fitted_until_s"),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not a fit ({error!r}); {NOT_A_FIT}") from error


def _choices(table: Mapping[str, Any]) -> Choices:
    effects = table.get("effects")
    return Choices(**{**table, "effects": None if effects is None else tuple(effects)})


def _state(table: Mapping[str, Any]) -> State:
    return State(
        float(table["t_s"]),
        np.array(table["position_m"], float),
        np.array(table["quaternion_wxyz"], float),
        np.array(table["velocity_m_s"], float),
        np.array(table["omega_rad_s"], float),
    )


def _matrix(rows: Any) -> Array | None:
    return None if rows is None else np.array(rows, float)
