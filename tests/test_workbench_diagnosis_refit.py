"""Where refits begin, and where else they look."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from workbench.diagnosis import refit, tempering
from workbench.fitting.search import NO_END


def test_bases_are_made_where_the_search_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not where the fit ended: closer to a bound than a search begins, there may be nothing left of a layer."""
    at: dict[str, Any] = {}

    class Search:
        free, scale = np.arange(1), np.ones(1)

        def inside(self, x: Any) -> Any:
            return x - 1e-6

        def evaluate(self, x: Any, _deviation: Any) -> Any:
            at["trusted"] = x
            return SimpleNamespace(vector=np.ones(1), data=SimpleNamespace(error=0.0))

        def minimise(self, x: Any, _deviation: Any, **_how: Any) -> Any:
            at["begun"] = x
            return SimpleNamespace(x=x)

    def cover(x: Any, *_how: Any) -> None:
        at["bases"] = x

    ended: Any = SimpleNamespace(search=Search(), here=SimpleNamespace(jacobian=np.ones((1, 1))), x=np.ones(1),
                                 effects=(), doubt=0.0)
    monkeypatch.setattr(refit, "refit_at", lambda *_of: ended)
    model: Any = SimpleNamespace(deviations=lambda: [0.01], fitted=SimpleNamespace(cover=cover),
                                 parameters=[SimpleNamespace(name="missing")])
    refit.rebuild_and_refine(model, ended)
    assert at["bases"] == at["trusted"] == at["begun"] == 1.0 - 1e-6


@pytest.mark.parametrize(("deep", "found"), [(2.0, True), (-9.0, False)])
def test_starts_are_drawn_where_a_part_is_explained_alone(deep: float, found: bool) -> None:
    """A cost with two basins, of the known parameter alone: from the worse one no step leads to the better one."""
    surrounded: list[Any] = []

    class Search:
        free, scale, precision = np.arange(2), np.ones(2), np.array([1.0, 0.0])
        objective = SimpleNamespace(recordings=[None])

        def thinned(self) -> Search:
            return self

        def minimise(self, x: Any, _deviation: Any, **_how: Any) -> Any:
            if x[0] > 4.0:
                raise NO_END[-1]("far off")
            deeper = abs(x[0] - deep) < 1.5
            return SimpleNamespace(x=np.array([deep if deeper else 0.0, x[1]]), cost=1.0 if deeper else 100.0)

    parameters = [SimpleNamespace(name="known", prior=1.0, start=0.0), SimpleNamespace(name="own", start=0.0)]
    model: Any = SimpleNamespace(known=1, parameters=parameters, index=lambda name: ["known", "own"].index(name),
                                 fitted=SimpleNamespace(cover=lambda x, *_how: surrounded.append(x)))
    effect: Any = SimpleNamespace(names=("own",))
    end: Any = SimpleNamespace(x=np.array([0.0, 7.0]), cost=50.0)
    better = tempering._sampled_descent(model, effect, Search(), end, np.array([1.0, 3.0]))  # type: ignore[arg-type]
    assert (better is not end) == found
    # With the known parameters of the place given and as much of the effect as there was.
    assert surrounded[0].tolist() == [1.0, 7.0]
    assert better.x[1] == 7.0


@pytest.mark.parametrize(("there", "better"), [(1.0, True), (3.0, False)])
def test_the_base_is_asked_for_where_an_effect_has_led_it(
    monkeypatch: pytest.MonkeyPatch, there: float, better: bool
) -> None:
    """Begun with what the known parameters are there and nothing of what the effect adds, which is not known."""
    begun: list[Any] = []

    class Search:
        centre = np.array([0.0, 0.0, 0.5])

        def minimise(self, x: Any, _deviation: Any, **_how: Any) -> Any:
            begun.append(x)
            return SimpleNamespace(x=x)

    names = ["known", "too thick", "own"]
    model: Any = SimpleNamespace(known=2, index=names.index, deviations=lambda: [0.01])
    base: Any = SimpleNamespace(search=Search(), evidence=2.0)
    other: Any = SimpleNamespace(evidence=there)
    monkeypatch.setattr(refit, "refit_at", lambda *_of: other)
    led: Any = SimpleNamespace(x=np.array([5.0, 6.0, 7.0]), effects=(SimpleNamespace(names=("too thick", "own")),))
    assert refit.without(model, base, led) is (other if better else base)
    assert begun[0].tolist() == [5.0, 6.0, 0.5]
