"""The model's curves on a bench: an equilibrium for every measured row, and their exact Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.equilibria import Equilibria, LoadRow, bench_scenario
from cosim.bench.outputs import outputs_of
from cosim.config.benches import BenchTable, Series
from cosim.errors import ScenarioError


@final
class Curves:
    """The model's values of all measured rows.

    Attributes: `rows`, their equilibria.

    Args:
        bench: checked.
        series: its curves.

    Raises:
        InputError: a parameter, load or quantity does not exist, or a start is outside its bounds.
    """

    def __init__(self, bench: BenchTable, series: Sequence[Series]) -> None:
        rows = [
            LoadRow(
                f"series.{entry.table.name}.loads", f"series.{entry.table.name}, row {row + 1}",
                entry.table.name, {name: values[row] for name, values in entry.loads.items()},
            )
            for entry in series for row in range(len(entry.values))
        ]  # fmt: skip
        self.rows = Equilibria(bench_scenario(bench.scenario, bench.set), bench.parameter, rows)
        self._names = list(dict.fromkeys(entry.table.quantity for entry in series))
        own = [self._names.index(entry.table.quantity) for entry in series for _ in entry.values]
        self._own = np.arange(len(rows)), np.array(own)
        for entry in series:
            if len(outputs_of([entry.table.quantity], self.rows.model)) != 1:
                raise ScenarioError(
                    f"series.{entry.table.name}.quantity", "means several numbers; name one, such as by .z"
                )

    def at(self, values: Array) -> Array:
        """Return the model's values (rows,) of all series.

        Raises:
            ConvergenceError: a row has no equilibrium.
        """
        self.rows.solve(values)
        return np.asarray(self.rows.read(self._names)[self._own])

    def jacobian(self, quantities: Sequence[str] = ()) -> Array:
        """Return the derivatives (rows, parameters) where `at` was called last; of other quantities if named.

        At a kink of the forces, as where film begins to wrinkle, they are those across it.

        Args:
            quantities: of all rows, one for each instead of its own; (quantities, rows, parameters).
        """
        if quantities:
            return np.moveaxis(self.rows.jacobian(quantities, kinks=True), 1, 0)
        return np.asarray(self.rows.jacobian(self._names, kinks=True)[self._own])
