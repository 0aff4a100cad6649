"""The tree of errors: stable codes, one sentence each."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import pytest

import mpf_core.cloud.errors  # its classes join the tree
from mpf_core import errors
from mpf_core.errors import Cancelled, Diverged, FitError, InputError, MPFError, OptionsError


def tree(root: type[MPFError]) -> Iterator[type[MPFError]]:
    yield root
    for branch in root.__subclasses__():
        yield from tree(branch)


ALL = [c for c in dict.fromkeys(tree(MPFError)) if c.__module__.startswith("mpf_core")]


def test_codes_are_unique_and_dotted_names() -> None:
    assert mpf_core.cloud.errors
    codes = [kind.code for kind in ALL]
    assert len(codes) == len(set(codes))
    assert all(code.replace(".", "").replace("_", "").isalpha() for code in codes)
    assert all(code == code.lower() for code in codes)


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        (errors.NotFinite, "cloud.not_finite"),
        (errors.TooSmall, "cloud.too_small"),
        (errors.TooLarge, "cloud.too_large"),
        (errors.Collinear, "cloud.collinear"),
        (errors.OptionsError, "options.invalid"),
        (errors.Diverged, "fit.diverged"),
        (errors.NoSurface, "surface.none"),
        (errors.ResolutionTooHigh, "surface.resolution_too_high"),
        (errors.Cancelled, "cancelled"),
    ],
)
def test_codes_that_clients_rely_on_stay(kind: type[MPFError], code: str) -> None:
    assert kind.code == code


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
def test_every_error_explains_itself(kind: type[MPFError]) -> None:
    assert kind.__doc__
    assert kind.__doc__.strip().splitlines()[0].endswith(".")
    error = kind("it is so", where="line 3", advice="Do that.")
    assert str(error) == "it is so (line 3). Do that."
    assert str(kind("it is so")) == "it is so."
    assert error.as_dict() == {
        "code": kind.code,
        "message": "it is so",
        "where": "line 3",
        "advice": "Do that.",
    }


def test_the_caller_is_at_fault_for_input_alone() -> None:
    assert issubclass(OptionsError, InputError)
    assert issubclass(errors.CloudError, InputError)
    assert issubclass(errors.FormatError, InputError)
    assert not issubclass(Diverged, InputError)
    assert issubclass(Diverged, FitError)
    assert not issubclass(Cancelled, FitError)


def test_errors_cross_processes_whole() -> None:
    # What is sent is made by the test itself.
    error = pickle.loads(pickle.dumps(errors.NoSurface("none", where="box", advice="Try.")))  # noqa: S301
    assert isinstance(error, errors.NoSurface)
    assert error.message == "none"
    assert (error.where, error.advice) == ("box", "Try.")
