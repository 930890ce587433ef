"""Fits a robot's values to measured curves by least squares, and computes their 95 % intervals. The minimised
sum is sum_k ((y_k - m_k) / s_k)^2 + sum_i ((p_i - p_i0) / q_i)^2, with the noise s_k of the data and the
priors q_i; the offset of a relative series is a further unknown. The Jacobian is exact. A first fit with the
loss soft_l1 is robust against outliers; rows beyond 4.5 standard deviations are then removed. The interval of
a parameter is its profile likelihood: the minimum over all other parameters is 3.84 above the least sum. If
the residuals are larger than the noise explains (chi^2, 5 %), 3.84 is multiplied by the ratio of their
variances. Source: Seber and Wild, Nonlinear Regression, section 5.10.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.bench.equilibria import Curves
from cosim.bench.identifiability import Identifiability, identifiability
from cosim.bench.oddities import oddities
from cosim.config.benches import BenchTable, Series
from cosim.config.toml.keys import unit_of
from cosim.errors import ConvergenceError, InputError

_FAR: Final = 4.5
_MAD: Final = 1.4826  # of the median of absolute residuals, which makes it a standard deviation
_CHI2: Final = 3.841458820694124  # of one degree of freedom, 95 %
_BY_NOISE: Final = 0.05  # probability of residuals below which noise has not made them
_ROUNDS: Final = 3
_FAILED: Final = 1e4  # residual of a row without an equilibrium, in standard deviations
_RESOLUTIONS: Final = {"m": 1e-4, "m3": 1e-7}  # of a camera and of a measuring cup
_FURTHER: Final = ("tip_position_m.x", "tip_position_m.y", "tip_position_m.z", "length_m", "volume_m3")
_EXACT: Final = 1e-7
_PROFILE: Final = 1e-4
_CHORDS, _SMALL_GAIN = 8, 1e-2  # most steps, and the decrease of the sum of squares at which they end


@final
@dataclass(frozen=True)
class Interval:
    """A fitted value with its 95 % interval.

    Args:
        value: at the minimum of the sum of squares.
        low: lower end of the 95 % interval.
        high: upper end.
        at_bound: whether the interval ends at a bound that the bench file gives.
    """

    value: float
    low: float
    high: float
    at_bound: bool


@final
@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Args:
        bench: table of the bench file.
        series: measured curves.
        check: whether the data determine the parameters, at the start.
        oddities: messages about probable mistakes in the data.
        found: a value for each parameter; empty if nothing was fitted.
        predicted: (rows,), the model's values at the fitted parameters, of all series one after the other.
        measured: (rows,), measured values.
        noise: (rows,), standard deviation.
        fitted: (rows,), whether a row was fitted.
        held_out: (rows,), whether a row was left out of the fit, to be predicted.
        outliers: (rows,), whether a row was removed from the fit as an outlier.
        equilibria: number of equilibria that were solved.
        band: (rows,), half of the 95 % interval of the measured value, from the uncertainty of the parameters
            and noise of the size of the residuals; NaN if nothing was fitted.
        zeros: (series,), offset of the model's values of a relative series, in its unit; 0 for others.
    """

    bench: BenchTable
    series: tuple[Series, ...]
    check: Identifiability
    oddities: tuple[str, ...]
    found: tuple[Interval, ...]
    predicted: Array
    measured: Array
    noise: Array
    fitted: Mask
    held_out: Mask
    outliers: Mask
    equilibria: int
    band: Array
    zeros: Array

    @property
    def scaled(self) -> Array:
        """(rows,), residuals over noise."""
        return np.asarray((self.predicted - self.measured) / self.noise)

    def rows_of(self, number: int) -> slice:
        """Return the rows of a series."""
        begin = sum(len(entry.values) for entry in self.series[:number])
        return slice(begin, begin + len(self.series[number].values))


@final
@dataclass(frozen=True, eq=False)
class Minimum:
    """The least sum of squares.

    Args:
        best: variables there.
        least: the sum.
        slopes: derivatives of the residuals there, by the variables.
    """

    best: Array
    least: float
    slopes: Array


@final
class Fit:
    """The least-squares problem. Its variables are parameters, or logarithms of those with positive bounds.

    Args:
        bench: checked table.
        series: measured curves.
    """

    def __init__(self, bench: BenchTable, series: Sequence[Series]) -> None:
        self.curves = Curves(bench, series)
        unknowns = bench.parameter
        self._logs = np.array([entry.low > 0.0 for entry in unknowns])
        self.low, self.high = (
            self.fitted(np.array([getattr(entry, end) for entry in unknowns])) for end in ("low", "high")
        )
        self.start = self.fitted(self.curves.rows.start)
        self.prior_sd = np.array([np.inf if entry.prior_sd is None else entry.prior_sd for entry in unknowns])
        parts = [self._measured(entry) for entry in series]
        self.measured, self.noise, self.held_out = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.rows = ~self.held_out
        ends = np.cumsum([0, *(len(entry.values) for entry in series)])
        self._firsts = ends[:-1]
        self._zeros = np.array([
            (np.arange(ends[-1]) >= begin) & (np.arange(ends[-1]) < end)
            for entry, begin, end in zip(series, ends[:-1], ends[1:], strict=True) if entry.table.relative
        ], dtype=np.float64).reshape(-1, ends[-1])  # fmt: skip
        self.low, self.high = (
            np.concatenate([end, np.full(len(self._zeros), side * np.inf)])
            for end, side in ((self.low, -1.0), (self.high, 1.0))
        )
        self._last: tuple[Array, Array] | None = None

    @property
    def count(self) -> int:
        """Number of parameters; the offsets of relative series are further variables after them."""
        return len(self.start)

    @staticmethod
    def _measured(entry: Series) -> tuple[Array, Array, Mask]:
        every, index = entry.table.hold_out, np.arange(len(entry.values))
        held = (index % every == every // 2) & (len(index) > 2) if every else np.zeros(len(index), bool)
        return np.array(entry.values), np.full(len(index), entry.noise), held

    def fitted(self, values: Array) -> Array:
        """Return the variables (logarithms or values) of parameters."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self._logs, np.log(values), values)

    def values(self, fitted: Array) -> Array:
        """Return the parameters of variables, as in the robot's file."""
        some = fitted[: self.count]
        return np.where(self._logs, np.exp(np.where(self._logs, some, 0.0)), some)

    def aligned(self, values: Array) -> Array:
        """Return variables (parameters,) with the offsets of relative series after them."""
        found = np.concatenate([values, np.zeros(len(self._zeros))])
        off = (self.measured - self.predicted(found)) / self.noise
        for place, rows in enumerate(self._zeros, start=self.count):
            found[place] = np.median(off[self.rows & (rows > 0.0)])
        return found

    def predicted(self, fitted: Array) -> Array:
        """Return the model's values (rows,); NaN if a row has no equilibrium."""
        if self._last is None or not np.array_equal(self._last[0], fitted[: self.count]):
            try:
                found = self.curves.at(self.values(fitted))
            except ConvergenceError:
                found = np.full(len(self.measured), np.nan)
            self._last = fitted[: self.count].copy(), found
        return np.asarray(self._last[1] + self.noise * (fitted[self.count :] @ self._zeros))

    def zeros(self, fitted: Array) -> Array:
        """Return the offset of each series, in its unit; 0 for series that are not relative."""
        added = self.noise * (fitted[self.count :] @ self._zeros)
        return np.asarray(added[self._firsts])

    def residuals(self, fitted: Array) -> Array:
        """Return residuals over noise of the fitted rows, then of the priors."""
        found = ((self.predicted(fitted) - self.measured) / self.noise)[self.rows]
        prior = (self.values(fitted) - self.curves.rows.start) / self.prior_sd
        return np.concatenate(
            [np.where(np.isfinite(found), found, _FAILED), prior[np.isfinite(self.prior_sd)]]
        )

    def scaled(self, fitted: Array, quantities: Sequence[str] = ()) -> Array:
        """Return derivatives (rows, parameters) by the variables, over noise; or of other quantities."""
        self.predicted(fitted)
        slope = np.where(self._logs, self.values(fitted), 1.0)
        found = self.curves.jacobian(quantities)
        return np.asarray(found * slope if quantities else found * slope / self.noise[:, None])

    def jacobian(self, fitted: Array) -> Array:
        """Return the derivatives of `residuals`."""
        data = np.concatenate([self.scaled(fitted), self._zeros.T], axis=1)[self.rows]
        prior = self.priors(fitted)
        return np.concatenate([data, np.pad(prior, ((0, 0), (0, len(self._zeros))))])

    def priors(self, fitted: Array) -> Array:
        """Return the derivatives (priors, parameters) of the priors' residuals."""
        slope = np.where(self._logs, self.values(fitted), 1.0)
        return np.asarray(np.diag(slope / self.prior_sd)[np.isfinite(self.prior_sd)])

    def information(self, fitted: Array) -> Array:
        """Return derivatives (rows, parameters) of data and priors, with unknown offsets of series."""
        rows = self.scaled(fitted)
        for of_series in self._zeros > 0.0:
            rows[of_series] -= rows[of_series & self.rows].mean(axis=0)
        return np.concatenate([rows[self.rows], self.priors(fitted)])

    def least(self, start: Array, loss: str = "linear", close: float = _EXACT) -> tuple[Array, float]:
        """Return the variables of the least sum of squares, and that sum.

        Args:
            start: initial variables.
            loss: of scipy's least squares.
            close: relative change of the sum at which the search ends.
        """
        from scipy.optimize import least_squares  # here: it takes long to load

        found = least_squares(
            self.residuals, np.clip(start, self.low, self.high), self.jacobian, bounds=(self.low, self.high),
            x_scale="jac", loss=loss, ftol=close, xtol=1e-9, gtol=1e-12, max_nfev=60,
        )  # fmt: skip
        return found.x, float((self.residuals(found.x) ** 2).sum())

    def band(self, minimum: Minimum, spread: float) -> Array:
        """Return half of the 95 % interval (rows,) of measured values, to first order in the parameters.

        Args:
            minimum: of the sum of squares.
            spread: variance of the residuals over that of the noise, at least 1.
        """
        rows = np.concatenate([self.scaled(minimum.best), self._zeros.T], axis=1)
        covariance = np.linalg.pinv(minimum.slopes.T @ minimum.slopes)
        known = np.einsum("ri,ij,rj->r", rows, covariance, rows)
        return np.asarray(np.sqrt(_CHI2 * spread * (1.0 + known)) * self.noise)

    def interval(self, minimum: Minimum, number: int, spread: float) -> Interval:
        """Return the 95 % interval of a parameter by profile likelihood.

        Args:
            minimum: of the sum of squares.
            number: index of the parameter.
            spread: variance of the residuals over that of the noise, at least 1.
        """
        best = minimum.best
        self.predicted(best)  # further equilibria are found from these
        covariance = np.linalg.pinv(minimum.slopes.T @ minimum.slopes)
        half = np.sqrt(_CHI2 * spread * covariance[number, number])
        lean, ends, at_bound = covariance[:, number] / covariance[number, number], list[float](), False
        for side, bound in ((-1.0, self.low[number]), (1.0, self.high[number])):

            def rise(x: float) -> float:
                return self._rise(minimum, number, x, lean) / spread

            end = _crossing(rise, float(best[number]), side * half, float(bound))
            at_bound = at_bound or end == bound
            ends.append(end)
        low, high = (float(self.values(self._with(best, number, end))[number]) for end in ends)
        return Interval(float(self.values(best)[number]), low, high, at_bound)

    @staticmethod
    def _with(point: Array, number: int, value: float) -> Array:
        found = point.copy()
        found[number] = value
        return found

    def _rise(self, minimum: Minimum, number: int, x: float, lean: Array) -> float:
        """Return the rise of the least sum of squares with one parameter at another value.

        The other variables are found by Gauss-Newton steps with the derivatives at the minimum.

        Args:
            minimum: of the sum of squares.
            number: index of the parameter.
            x: value of the parameter.
            lean: (variables,), initial derivatives of all variables by it.
        """
        best, found = minimum.best, np.inf
        free = np.arange(len(best)) != number
        point = np.clip(best + (x - best[number]) * lean, self.low, self.high)
        point[number] = x
        for _ in range(_CHORDS):
            left = self.residuals(point)
            before, found = found, min(found, float(left @ left))
            slopes = minimum.slopes[:, free]
            step = np.linalg.lstsq(slopes, -left, rcond=None)[0]
            gain = float(((slopes @ step) ** 2).sum())
            if gain < _SMALL_GAIN or before - found < _SMALL_GAIN:
                break
            point[free] = np.clip(point[free] + step, self.low[free], self.high[free])
        return max(0.0, found - minimum.least)


def spread_of(least: float, freedom: int) -> float:
    """Return the variance of residuals over that of the noise; 1 if noise explains them (chi^2, 5 %).

    Args:
        least: sum of squares of residuals over noise.
        freedom: number of rows less number of variables.
    """
    from scipy.special import gammaincc  # here: it takes long to load

    return least / freedom if gammaincc(0.5 * freedom, 0.5 * least) < _BY_NOISE else 1.0


def _crossing(rise: Callable[[float], float], best: float, step: float, bound: float) -> float:
    """Return the value at which a rise equals the quantile, or the bound; its root is nearly linear."""
    wanted, at = np.sqrt(_CHI2), step
    for _ in range(8):
        outside = abs(at) >= abs(bound - best)
        at = bound - best if outside else at
        if at == 0.0:
            return bound
        root = np.sqrt(rise(best + at))
        if outside and root < wanted:
            return bound
        if abs(root - wanted) < 1e-2 * wanted:
            break
        at *= min(4.0, max(0.25, wanted / max(root, 1e-9)))
    return float(best + at)


def identify(
    bench: BenchTable, series: Sequence[Series], *, only_check: bool = False, force: bool = False,
    tell: Callable[[str], None] = lambda _text: None,
) -> Identified:  # fmt: skip
    """Identify the parameters of a bench from its measured curves.

    Args:
        bench: see `load_bench`.
        series: measured curves.
        only_check: whether to check without a fit.
        force: whether to fit even if a check fails.
        tell: called with messages of progress.

    Raises:
        InputError: the data do not determine a parameter, or look wrong, unless forced.
        ConvergenceError: a row has no equilibrium at the start.
    """
    fit = Fit(bench, series)
    tell(f"{len(fit.measured)} rows of {len(series)} series, {len(bench.parameter)} values")
    start = fit.aligned(fit.start)
    if not np.isfinite(start).all() or not np.isfinite(fit.predicted(start)).all():
        fit.curves.at(fit.values(start))  # raises again
    odd, check = _odd(fit, series, start), _check(fit, bench, start)
    if only_check:
        return _result(fit, bench, series, check, odd, (), start)
    problems = [*odd, *(() if check.good else check.lines())]
    if problems and not force:
        raise InputError("\n".join((*problems, "--force fits in spite of this")))
    best, outliers = _without_outliers(fit, start)
    best, least = fit.least(best)
    spread = spread_of(least, max(1, int(fit.rows.sum()) - len(best)))
    tell(f"fitted after {fit.curves.rows.solved} equilibria; intervals follow")
    minimum = Minimum(best, least, fit.jacobian(best))
    found = tuple(fit.interval(minimum, number, spread) for number in range(fit.count))
    result = _result(fit, bench, series, check, odd, found, best, outliers)
    return replace(result, band=fit.band(minimum, spread))


def _without_outliers(fit: Fit, start: Array) -> tuple[Array, Mask]:
    """Return the variables of a robust fit, and its outliers (rows,), which are removed from the fit."""
    best, outliers = start, np.zeros(len(fit.measured), bool)
    for _ in range(_ROUNDS):
        best, _ = fit.least(best, loss="soft_l1", close=_PROFILE)
        scaled = np.abs(fit.predicted(best) - fit.measured) / fit.noise
        usual = max(1.0, _MAD * float(np.median(scaled[fit.rows])))
        new = fit.rows & (scaled > _FAR * usual)
        if not new.any():
            break
        outliers |= new
        fit.rows = fit.rows & ~new
    return best, outliers


def _odd(fit: Fit, series: Sequence[Series], start: Array) -> list[str]:
    ends = np.cumsum([len(entry.values) for entry in series])[:-1]
    return oddities(series, np.split(fit.predicted(start), ends))


def _check(fit: Fit, bench: BenchTable, start: Array) -> Identifiability:
    scaled = fit.information(start)
    further = {}
    if len(bench.parameter) > 1:
        names = [name for name in _FURTHER if name not in {each.quantity for each in bench.series}]
        for name, each in zip(names, fit.scaled(start, names), strict=True):
            further[name] = each / _RESOLUTIONS[unit_of(name.partition(".")[0])]
    return identifiability(scaled, (fit.high - fit.low)[: fit.count], bench.parameter, further)


def _result(
    fit: Fit, bench: BenchTable, series: Sequence[Series], check: Identifiability, odd: list[str],
    found: tuple[Interval, ...], at: Array, outliers: Mask | None = None,
) -> Identified:  # fmt: skip
    predicted = fit.predicted(at)
    removed = np.zeros(len(predicted), bool) if outliers is None else outliers
    return Identified(
        bench, tuple(series), check, tuple(odd), found, predicted, fit.measured, fit.noise, fit.rows,
        fit.held_out, removed, fit.curves.rows.solved, np.full(len(predicted), np.nan), fit.zeros(at),
    )  # fmt: skip
