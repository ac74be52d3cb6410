# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal opacity: the factor by which a Gaussian's opacity changes with time.

The parameters are one array [N, P] per model; each kind says what its columns are.  `code` is how the kernels know the kind;
`logarithms` says which columns are natural logarithms.  factor() is the opacity's factor at a time, span() the time in which the
factor is at least exp(-visible).
"""
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..util.errors import FastGSError


class Span(NamedTuple):
    """Begin and end [N] of times, one of each Gaussian."""

    begin: np.ndarray
    end: np.ndarray


@dataclass(frozen=True)
class Always:
    """Opacity does not change (P = 0).

    Example:
        kind = fg.Always()
    """

    name: ClassVar[str] = "always"
    code: ClassVar[int] = 0
    width: ClassVar[int] = 0
    logarithms: ClassVar[tuple[bool, ...]] = ()

    def factor(self, t: float, mu_tau: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Factor [N] float64 at time t; mu_tau [N], parameters [N, P]."""
        return np.ones(len(mu_tau))

    def span(self, visible: Any, mu_tau: np.ndarray, parameters: np.ndarray) -> Span:
        """Begin and end [N] of the time in which the factor is at least exp(-visible [N]); the clip's where there is no end.

        visible [N] float64; mu_tau [N] and parameters [N, P] are the Gaussians', see GaussianModel
        """
        return Span(np.zeros(len(mu_tau)), np.ones(len(mu_tau)))


@dataclass(frozen=True)
class Radial:
    """The paper's (eq. 6): exp(-s_tau (t - mu_tau)^2).  Column 0: ln s_tau.

    Example:
        kind = fg.Radial()
    """

    name: ClassVar[str] = "radial"
    code: ClassVar[int] = 1
    width: ClassVar[int] = 1
    logarithms: ClassVar[tuple[bool, ...]] = (True,)

    def factor(self, t: float, mu_tau: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Factor [N] float64 at time t; mu_tau [N], parameters [N, 1]."""
        delta = t - np.asarray(mu_tau, np.float64)
        return np.exp(-np.exp(np.asarray(parameters[:, 0], np.float64)) * delta**2)

    def span(self, visible: Any, mu_tau: np.ndarray, parameters: np.ndarray) -> Span:
        """As Always.span: begin and end [N]; mu_tau [N], parameters [N, 1]."""
        reach = np.sqrt(visible * np.exp(-parameters[:, 0].astype(np.float64)))
        return Span(mu_tau - reach, mu_tau + reach)


@dataclass(frozen=True)
class Window:
    """1 from begin to end, and a soft flank on either side: exp(-(d / width)^2), d the distance from the window.

    Columns: begin, end, ln width before, ln width after.

    Example:
        kind = fg.Window()
    """

    name: ClassVar[str] = "window"
    code: ClassVar[int] = 2
    width: ClassVar[int] = 4
    logarithms: ClassVar[tuple[bool, ...]] = (False, False, True, True)

    def factor(self, t: float, mu_tau: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Factor [N] float64 at time t; mu_tau [N], parameters [N, 4]."""
        begin, end, before, after = np.asarray(parameters, np.float64).T
        early, late = np.maximum(begin - t, 0), np.maximum(t - end, 0)
        return np.exp(-((early / np.exp(before)) ** 2) - (late / np.exp(after)) ** 2)

    def span(self, visible: Any, mu_tau: np.ndarray, parameters: np.ndarray) -> Span:
        """As Always.span: begin and end [N]; mu_tau [N], parameters [N, 4]."""
        begin, end, before, after = parameters.T.astype(np.float64)
        return Span(begin - np.exp(before) * np.sqrt(visible), end + np.exp(after) * np.sqrt(visible))


@dataclass(frozen=True)
class WindowedRadial:
    """Radial, times a window with flanks of one softness: a Gaussian of one segment of a long capture (joining.py).

    Columns: ln s_tau, begin, end, ln width of the flanks; see Radial and Window.

    Example:
        kind = fg.WindowedRadial()
    """

    name: ClassVar[str] = "radial-window"
    code: ClassVar[int] = 3
    width: ClassVar[int] = 4
    logarithms: ClassVar[tuple[bool, ...]] = (True, False, False, True)

    def factor(self, t: float, mu_tau: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Factor [N] float64 at time t; mu_tau [N], parameters [N, 4]."""
        _, begin, end, soft = np.asarray(parameters, np.float64).T
        outside = np.maximum(np.maximum(begin - t, t - end), 0)
        return Radial().factor(t, mu_tau, parameters) * np.exp(-((outside / np.exp(soft)) ** 2))

    def span(self, visible: Any, mu_tau: np.ndarray, parameters: np.ndarray) -> Span:
        """As Always.span: begin and end [N]; mu_tau [N], parameters [N, 4].  Where both fade, a little more than that."""
        _, begin, end, soft = parameters.T.astype(np.float64)
        low, high = Radial().span(visible, mu_tau, parameters)
        flank = np.exp(soft) * np.sqrt(visible)
        return Span(np.clip(low, begin - flank, end + flank), np.clip(high, begin - flank, end + flank))


KINDS = {cls.name: cls for cls in (Always, Radial, Window, WindowedRadial)}


def temporal_by_name(name: str) -> Any:
    """The kind of that name; raises FastGSError for an unknown one."""
    if name not in KINDS:
        raise FastGSError(f"the temporal opacity {name!r} is unknown; this version knows {', '.join(KINDS)}.")
    return KINDS[name]()
