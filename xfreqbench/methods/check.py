"""Checks whether a method keeps its contract, by trying every part of it on a small data set of plane waves."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, suppress
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.collection import Collection, room_of, write_collection
from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.data.plane_waves import RECEIVER, plane_waves, stored_channels
from xfreqbench.data.splits import Question
from xfreqbench.data.unseen_rooms import ASKED_GHZ, HEARD_GHZ, NUM_ASKED, room_question
from xfreqbench.errors import UnknownNameError, XFreqBenchError
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Progress, RoomMethod, RoomPredictor
from xfreqbench.methods.fitting import (
    checked_findings,
    checked_maps,
    checked_num_parameters,
    fit_within,
    predict_checked,
)
from xfreqbench.methods.guard import method_code
from xfreqbench.methods.registry import build_method, device_option, name_of
from xfreqbench.system.arguments import Texts, checked
from xfreqbench.types import IntArray, NDArray
from xfreqbench.units import ghz_to_hz

NUM_STEPS = 10  # of every fit; a broken contract shows in a few steps
_BUDGET = Budget(max_steps=NUM_STEPS)
_SEED = 1
_CARRIER_HZ = np.array([ghz_to_hz(carrier) for carrier in (2.4, 24.25, 77.0)])
_UNSEEN_CARRIER, _UNSEEN_TX, _NUM_TX = 1, 5, 6
_REPEAT_TOLERANCE = 1e-6  # rounding of the same arithmetic in single precision
_BATCH_TOLERANCE = 1e-4  # libraries add in another order for another number of rows
_SEED_TOLERANCE = 1e-4  # rounding over a few steps


@dataclass(frozen=True)
class CheckResult:
    """A requirement of the contract, and what is wrong with the method if it does not meet it, else None.

    A warning is worth a correction, but does not break the contract. Where `is_untried`, the requirement could not be
    tried because of an earlier fault, which `fault` names.
    """

    requirement: str
    fault: str | None = None
    is_warning: bool = False
    is_untried: bool = False

    @property
    def is_fault(self) -> bool:
        """Whether the contract is broken."""
        return self.fault is not None and not self.is_warning and not self.is_untried

    def __str__(self) -> str:
        if self.fault is None:
            return f"ok     {self.requirement}"
        label = "skip  " if self.is_untried else "warn  " if self.is_warning else "FAULT "
        return f"{label} {self.requirement}: {self.fault}"


@checked
def check_method(method: str | type, overrides: Texts = ()) -> list[CheckResult]:
    """Check a method, given by name, as `package.module:Class` or as a class; returns a result for each requirement.

    The checks construct, fit, predict and save, in this order. After a fault they go on with whatever can be tried
    in spite of it; a requirement that cannot is marked as untried. A method that learns across rooms is fitted to some
    rooms, adapted to another, and predicts there. Raises `UnknownNameError` for an unknown name or option.
    """
    with tempfile.TemporaryDirectory() as folder:
        trial = _Trial(name_of(method), tuple(overrides), Path(folder))
        trial.working_folder.mkdir()
        with suppress(XFreqBenchError):
            if isinstance(trial.built, RoomMethod):
                return list(_results(_RoomTrial(trial.name, trial.overrides, trial.folder), _ROOM_STAGES))
        return list(_results(trial, _STAGES))


def _results(trial: _Trial, stages: Sequence[Sequence[_Check]]) -> Iterator[CheckResult]:
    broken: CheckResult | None = None  # the first of the gates, each the first check of a stage, that has a fault
    num_sound = len(stages)
    for number, (gate, *checks) in enumerate(stages):
        for check in (gate, *checks):
            needs = number + (check is not gate) if check.needs is None else check.needs
            result = broken if broken and needs > num_sound else _result(check, trial)
            if broken and result.fault == broken.fault:
                why = f"not tried, because of the fault in {broken.requirement!r}"
                result = CheckResult(check.requirement, why, is_untried=True)
            yield result
            if check is gate and result.is_fault and not broken:
                broken, num_sound = result, number


@dataclass(frozen=True)
class _Check:
    requirement: str
    fault_of: Callable[[Any], object]  # the fault as a text; whatever else is returned means that there is none
    is_warning: bool = False
    compares_fits: bool = False  # which says something where equal seeds give equal maps
    needs: int | None = None  # how many stages' gates have to be sound for it; all up to its own if None


def _result(check: _Check, trial: _Trial) -> CheckResult:
    if check.compares_fits and _seeds_differ(trial):
        return CheckResult(check.requirement, "not checked, because equal seeds give different maps", True)
    return CheckResult(check.requirement, _fault_or_exception(check, trial), check.is_warning)


def _seeds_differ(trial: _Trial) -> bool:
    try:
        with method_code("it raised", ""):
            return _seed_fault(trial) is not None
    except XFreqBenchError:
        return False  # whatever it raises, the check that follows raises and tells


def _fault_or_exception(check: _Check, trial: _Trial) -> str | None:
    try:
        with method_code("it raised", ""):
            found = check.fault_of(trial)
            return found if isinstance(found, str) else None
    except UnknownNameError:
        raise
    except XFreqBenchError as error:
        return str(error)


@dataclass
class _Trial:
    """The method that is checked. Its data set, its fit and its predictions are made when they are first needed."""

    name: str
    overrides: tuple[str, ...]
    folder: Path
    steps: list[Any] = field(default_factory=list)
    predicts_by: ClassVar[str] = "predict"

    @property
    def working_folder(self) -> Path:
        """The working folder of all checks: a method that writes to a relative path writes here."""
        return self.folder / "working"

    @cached_property
    def built(self) -> Any:
        return build_method(self.name, self.overrides)

    def new(self) -> Any:
        """A new untrained method with the same configuration."""
        return type(self.built)(self.built.config)

    @cached_property
    def dataset(self) -> PasDataset:
        return _write_dataset(self.folder / "data.h5")

    @cached_property
    def fitted(self) -> Any:
        return self.fit(self.dataset, lambda before, now: self.steps.append(now.step))

    def maps_of(self, method: Any) -> Float[NDArray[np.float32], "B E A"]:
        """What a method predicts for all samples at the unseen carrier or of the unseen transmitter."""
        return self.predict(method, self.test.rows)

    @cached_property
    def maps(self) -> Float[NDArray[np.float32], "B E A"]:
        """`maps_of` the fitted method."""
        return self.maps_of(self.fitted)

    def difference_fault(self, method: Any, tolerance: float, remedy: str) -> str | None:
        """What is wrong where the maps of a method differ from those of the fitted one."""
        return _difference_fault(self.maps_of(method), self.maps, tolerance, remedy)

    @cached_property
    def repeated_maps(self) -> Float[NDArray[np.float32], "B E A"]:
        """As `maps`, from another fit with the same seed."""
        return self.maps_of(self.fit(self.dataset))

    @property
    def test(self) -> PasDataset:
        return self.dataset[np.flatnonzero(~_is_training(self.dataset))]

    def fit(
        self,
        dataset: PasDataset,
        observe: Callable[[Any, Any], None] | None = None,
        budget: Budget = _BUDGET,
        method: Any = None,
    ) -> Any:
        """Fit a method, a new one if none is given, to the training rows of a data set, and return it."""
        return self.fit_to(_training_rows(dataset), observe, budget, method)

    def fit_to(
        self,
        train: PasDataset | Collection,
        observe: Callable[[Any, Any], None] | None = None,
        budget: Budget = _BUDGET,
        method: Any = None,
    ) -> Any:
        """Fit a method, a new one if none is given, to all that is given, and return it."""
        method = method or self.new()
        with chdir(self.working_folder):
            fit_within(method, train, budget, _SEED, observe=observe)
        return method

    def predict(self, method: Any, rows: Int[IntArray, "B"]) -> Float[NDArray[np.float32], "B E A"]:
        """Predictions for some rows of the data set, checked in the same way as in a run."""
        asked = self.dataset[rows]
        with chdir(self.working_folder):
            return predict_checked(method, asked.tx_position_m.copy(), asked.carrier_hz.copy(), self.dataset.grid.shape)


def _training_rows(dataset: PasDataset) -> PasDataset:
    """The samples that a method is given: all but those of the unseen transmitter or at the unseen carrier."""
    return isolated(dataset[np.flatnonzero(_is_training(dataset))])


def _is_training(dataset: PasDataset) -> NDArray[np.bool_]:
    unseen_hz = dataset.header.carrier_hz[_UNSEEN_CARRIER]
    return (dataset.tx_index != _UNSEEN_TX) & (dataset.carrier_hz != unseen_hz)


def _config_fault(trial: _Trial) -> str | None:
    as_json(trial.built.config)
    kind = type(trial.built.config)
    if not kind.__dataclass_params__.frozen:
        return f"{kind.__name__} can be changed after it is made. Write @dataclass(frozen=True)."
    return None


def _fit_fault(trial: _Trial) -> str | None:
    yields = trial.new().fit(_training_rows(trial.dataset), _BUDGET, _SEED)
    if not hasattr(yields, "__iter__"):
        return f"fit returned {yields!r}. Let it `yield Progress(step, loss)`, which makes it a generator."
    _ = trial.fitted
    return None


def _first_yield_fault(trial: _Trial) -> str | None:
    method = trial.new()
    with chdir(trial.working_folder):
        yields = iter(method.fit(_training_rows(trial.dataset), _BUDGET, _SEED))
        first = next(yields)
        assert isinstance(first, Progress), "the whole fit was run before"
        trial.predict(method, trial.test.rows[:1])
        getattr(yields, "close", lambda: None)()
    trial.predict(method, trial.test.rows[:1])
    return None


class _EnoughError(Exception):
    """Two steps of a fit are over."""


def _end_at(step: float) -> Callable[[Any, Any], None]:
    """An observer that ends a fit, as the end of its budget does, at a step, or at the second one that is yielded."""

    def look(before: Any, now: Any) -> None:
        if now.step >= step or (before and step == inf):
            raise _EnoughError

    return look


def _budgets_fault(trial: _Trial) -> str | None:
    """Begin a fit with a budget in maps, which is the default, with one in seconds and with none."""
    for budget in (Budget(max_maps=64_000), Budget(max_seconds=60.0), Budget()):
        with suppress(_EnoughError):
            trial.fit(trial.dataset, _end_at(inf), budget)
    return None


def _device_fault(trial: _Trial) -> str | None:
    default = getattr(build_method(trial.name).config, "device", "cpu")
    if default != "cpu":
        return f"its option device is {default!r} by default. Let it be 'cpu', and `run --device cuda` change it."
    on_gpu = device_option(trial.name, "cuda")
    if on_gpu:
        import torch

        if torch.cuda.is_available():
            _Trial(trial.name, (*trial.overrides, *on_gpu), trial.folder).fit(trial.dataset)
    return None


def _end_fault(trial: _Trial) -> str | None:
    """Close a fit at its last yield, if it ended by itself, and compare the outcome."""
    if trial.steps[-1] >= NUM_STEPS:
        return None
    method = trial.new()
    with suppress(_EnoughError):
        trial.fit(trial.dataset, _end_at(trial.steps[-1]), method=method)
    return trial.difference_fault(
        method, _SEED_TOLERANCE, "Change nothing after the last yield: restore the best weights before it."
    )


def _peak_fault(trial: _Trial) -> str | None:
    peaks = trial.maps.max(axis=(1, 2))
    if abs(peaks - 1).max() > 1e-2:  # a peak between two grid points is a little lower
        return f"the maxima of the maps run from {peaks.min():g} to {peaks.max():g}. Divide each map by its own."
    return None


def _repeat_fault(trial: _Trial) -> str | None:
    return trial.difference_fault(
        trial.fitted, _REPEAT_TOLERANCE, "Draw nothing at random in predict, and leave dropout out."
    )


def _batch_fault(trial: _Trial) -> str | None:
    order = np.arange(len(trial.test))[::-1]
    in_another_order = trial.predict(trial.fitted, trial.test.rows[order])
    return _difference_fault(in_another_order, trial.maps[order], _BATCH_TOLERANCE, _OWN_ROW)


def _single_row_fault(trial: _Trial) -> str | None:
    alone = np.concatenate([trial.predict(trial.fitted, trial.test.rows[[row]]) for row in (0, 1)])
    return _difference_fault(alone, trial.maps[:2], _BATCH_TOLERANCE, _OWN_ROW)


_OWN_ROW = "Let every row depend on its own transmitter and carrier alone: no mean over the batch, no state."


def _saved_fault(trial: _Trial) -> str | None:
    folder = trial.folder / "saved"
    folder.mkdir()
    with chdir(trial.working_folder):
        trial.fitted.save(folder)
        loaded = type(trial.fitted).load(folder)
    if loaded.config != trial.fitted.config:
        return f"the loaded method has {loaded.config!r}, the saved one {trial.fitted.config!r}. Save it too."
    return trial.difference_fault(loaded, _REPEAT_TOLERANCE, f"Save everything that {trial.predicts_by} uses.")


def _seed_fault(trial: _Trial) -> str | None:
    advice = "Draw from the seed alone, and from nothing global."
    return _difference_fault(trial.repeated_maps, trial.maps, _SEED_TOLERANCE, advice)


def _peeking_fault(trial: _Trial) -> str | None:
    """Predict and save at every yield of a fit, and compare the outcome."""
    folder = trial.folder / "peeked"
    folder.mkdir()
    method = trial.new()

    def look(before: object, now: object) -> None:
        trial.predict(method, trial.test.rows[:1])
        method.save(folder)

    trial.fit(trial.dataset, look, method=method)
    return trial.difference_fault(
        method, _SEED_TOLERANCE, "Let predict and save change no weight, no mode and no generator."
    )


def _leak_fault(trial: _Trial) -> str | None:
    """Fit to a data set that differs in the test rows only, and compare the outcome."""
    method = trial.fit(_write_dataset(trial.folder / "other.h5", has_other_test_rows=True))
    return trial.difference_fault(
        method, _SEED_TOLERANCE, "Read the training data through `train` alone, never its file."
    )


def _memory_fault(trial: _Trial) -> str | None:
    """Fit to all samples, as for another split, then to the training rows as before, and compare the outcome."""
    trial.fit_to(isolated(trial.dataset))
    return trial.difference_fault(
        trial.fit(trial.dataset), _SEED_TOLERANCE, "Keep what is learned in the instance, not in a module or a class."
    )


def _changed_data_fault(trial: _Trial) -> str | None:
    train = _training_rows(trial.dataset)
    given = deepcopy(arrays := _arrays_of(train))
    trial.fit_to(train)
    changed = [name for name, values in arrays.items() if not np.array_equal(values, given[name])]
    return f"it changed {', '.join(changed)}. Change copies of them." if changed else None


def _arrays_of(data: PasDataset) -> dict[str, NDArray[Any]]:
    grid = {"grid.elevation_rad": data.grid.elevation_rad, "grid.azimuth_rad": data.grid.azimuth_rad}
    shown = {"rows": data.rows, "tx_position_m": data.tx_position_m, "carrier_hz": data.carrier_hz}
    return {**shown, "header.carrier_hz": data.header.carrier_hz, **grid, **data.tables}


def _stray_file_fault(trial: _Trial) -> str | None:
    strays = sorted(path.name for path in trial.working_folder.iterdir())
    if strays:
        return f"it wrote {', '.join(strays)} there. Write in the folder that save is given, and nowhere else."
    return None


def _difference_fault(
    maps: Float[NDArray[np.float32], "B E A"],
    expected: Float[NDArray[np.float32], "B E A"],
    tolerance: float,
    remedy: str,
) -> str | None:
    difference = float(abs(maps - expected).max())
    if difference <= tolerance:
        return None
    return f"the maps differ by up to {difference:.2g}, and may by {tolerance:g}. {remedy}"


_STAGES = (
    (
        _Check("it can be constructed, with and without its config", _Trial.new),
        _Check("its config is a frozen dataclass that can be written as JSON", _config_fault),
    ),
    (
        _Check("fit is a generator that yields Progress, its steps ascending", _fit_fault),
        _Check("predict is valid at fit's first yield, and fit can be closed there", _first_yield_fault),
        _Check("fit takes a budget in maps, in seconds, or none", _budgets_fault),
        _Check("it computes on the device that it is told, if it has an option for that", _device_fault, needs=1),
        _Check("num_parameters is an integer of 0 or more", lambda trial: checked_num_parameters(trial.fitted)),
        _Check("findings, if it has them, are values that JSON holds", lambda trial: checked_findings(trial.fitted)),
    ),
    (
        _Check(
            "predict returns float32 maps in [0, 1] at a carrier it was not trained on",
            lambda trial: trial.predict(trial.fitted, trial.test.rows[trial.test.tx_index != _UNSEEN_TX]),
        ),
        _Check(
            "predict returns maps for a transmitter that it was not trained on",
            lambda trial: trial.predict(trial.fitted, trial.test.rows[trial.test.tx_index == _UNSEEN_TX]),
            needs=2,
        ),
        _Check("every map has peak 1", _peak_fault),
        _Check("predict answers the same when asked twice", _repeat_fault),
        _Check("a row's map does not depend on the other rows", _batch_fault),
        _Check("a row that is asked for alone gets the same map", _single_row_fault),
        _Check("a method that was saved and loaded predicts the same", _saved_fault, needs=2),
        _Check("the same seed gives the same maps", _seed_fault, is_warning=True),
        _Check("predict and save do not change how training goes on", _peeking_fault, compares_fits=True),
        _Check("a fit that ends early can as well be closed at its last yield", _end_fault, compares_fits=True),
        _Check("only training rows are used", _leak_fault, compares_fits=True),
        _Check("a fit uses nothing of an earlier one", _memory_fault, compares_fits=True),
        _Check("fit leaves the training data as they are", _changed_data_fault, is_warning=True, needs=1),
        _Check("nothing is written into the working folder", _stray_file_fault, needs=1),
    ),
)


def _write_dataset(path: Path, has_other_test_rows: bool = False) -> PasDataset:
    """A data set of six transmitters × three carriers; another has the same channels in the training rows only."""
    tx_position_m, cfr = plane_waves(_CARRIER_HZ, _NUM_TX)
    if has_other_test_rows:
        other = np.roll(cfr, 2, axis=0)
        cfr[_UNSEEN_TX], cfr[:, _UNSEEN_CARRIER] = other[_UNSEEN_TX], other[:, _UNSEEN_CARRIER]
    return stored_channels(path, RECEIVER, _CARRIER_HZ, tx_position_m, cfr, maps=True)


_ROOM_SEEDS, _HEARD = (0, 1, 2), 4  # the rooms, of which the last is not trained on, and transmitters heard there


class _RoomTrial(_Trial):
    """A method that learns across rooms, with three rooms of plane waves, two of which it is fitted to."""

    predicts_by = "adapt"

    @cached_property
    def rooms(self) -> Collection:
        folder, carrier_hz = self.folder / "rooms", np.array(sorted(map(ghz_to_hz, (*HEARD_GHZ, *ASKED_GHZ))))
        for seed in _ROOM_SEEDS:
            channels = plane_waves(carrier_hz, NUM_ASKED + _HEARD, seed)
            stored_channels(folder / f"{seed}.h5", RECEIVER, carrier_hz, *channels, maps=False)
        rooms = [room_of(folder, f"{seed}.h5", seed, "plane waves") for seed in _ROOM_SEEDS]
        return write_collection(
            folder, rooms, name="plane waves", family={}, options={}, carrier_hz=carrier_hz.tolist()
        )

    def question(self, num_heard: int = _HEARD, room: int = _ROOM_SEEDS[-1]) -> Question:
        return room_question(self.rooms[room], room, num_heard)

    @cached_property
    def fitted(self) -> Any:
        return self.fitted_to_rooms(lambda before, now: self.steps.append(now.step))

    def fitted_to_rooms(self, observe: Callable[[Any, Any], None] | None = None) -> Any:
        return self.fit_to(self.rooms[list(_ROOM_SEEDS[:-1])], observe)

    def maps_of(self, method: Any, num_heard: int = _HEARD) -> Float[NDArray[np.float32], "B E A"]:
        """What the method predicts of the room that it was not trained on."""
        question = self.question(num_heard)
        with chdir(self.working_folder):
            return _asked_of(method.adapt(question.heard, _BUDGET), question.asked)

    @cached_property
    def repeated_maps(self) -> Float[NDArray[np.float32], "B E A"]:
        return self.maps_of(self.fitted_to_rooms())

    def own_row_fault(self) -> str | None:
        question = self.question()
        alone = _asked_of(self.fitted.adapt(question.heard, _BUDGET), question.asked[[1]])
        return _difference_fault(alone, self.maps[[1]], _BATCH_TOLERANCE, _OWN_ROW)

    def next_room_fault(self) -> str | None:
        """Adapt to another room in between."""
        question, _ = self.question(room=0), self.maps
        _asked_of(self.fitted.adapt(question.heard, _BUDGET), question.asked)
        advice = "Keep what is adapted in the predictor, and leave the method as it is."
        return self.difference_fault(self.fitted, _REPEAT_TOLERANCE, advice)


def _asked_of(predictor: RoomPredictor, asked: PasDataset) -> Float[NDArray[np.float32], "B E A"]:
    maps = predictor.predict(asked.tx_position_m.copy(), asked.carrier_hz.copy())
    return checked_maps(predictor, maps, (len(asked), *asked.grid.shape))


_ROOM_STAGES = (
    _STAGES[0],
    (
        _Check("fit is a generator that yields Progress, its steps ascending", lambda room: room.fitted),
        _Check("num_parameters is an integer of 0 or more", lambda room: checked_num_parameters(room.fitted)),
    ),
    (
        _Check(
            "adapt returns what predicts float32 maps in [0, 1] of a room that it was not trained on",
            lambda room: room.maps,
        ),
        _Check("adapt takes a room of which nothing is heard", lambda room: room.maps_of(room.fitted, num_heard=0)),
        _Check("every map has peak 1", _peak_fault),
        _Check("a row that is asked for alone gets the same map", _RoomTrial.own_row_fault),
        _Check("adapting to one room changes nothing for the next", _RoomTrial.next_room_fault),
        _Check("a method that was saved and loaded predicts the same", _saved_fault, needs=2),
        _Check("the same seed gives the same maps", _seed_fault, is_warning=True),
        _Check("nothing is written into the working folder", _stray_file_fault, needs=1),
    ),
)
