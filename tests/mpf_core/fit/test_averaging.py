import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from mpf_core.fit.averaging import Averaging


def module(value: float) -> nn.Linear:
    made = nn.Linear(2, 1)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.fill_(value)
    return made


def moved(made: nn.Linear, value: float) -> None:
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.fill_(value)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60), st.floats(0.5, 0.999))
def test_the_mean_lies_between_the_states_it_was_made_of(values: list[float], share: float) -> None:
    made = module(values[0])
    averaging = Averaging(made, share)
    for value in values:
        moved(made, value)
        averaging.add()
    found = averaging.mean["weight"].numpy()
    assert np.all(found >= min(values) - 1e-5) and np.all(found <= max(values) + 1e-5)


def test_a_late_state_weighs_one_minus_the_share() -> None:
    made = module(0.0)
    averaging = Averaging(made, 0.9)
    for _ in range(500):
        averaging.add()
    moved(made, 1.0)
    averaging.add()
    torch.testing.assert_close(averaging.mean["bias"], torch.full((1,), 0.1))


def test_the_module_is_the_mean_within_and_itself_afterwards() -> None:
    made = module(0.0)
    averaging = Averaging(made, 0.9)
    with averaging.shown() as state:
        assert float(state["bias"]) == 0.0
    averaging.add()
    moved(made, 1.0)
    averaging.add()
    with averaging.shown() as state:
        assert 0.0 < float(state["bias"]) < 1.0
        assert float(made.bias) == float(state["bias"])
    assert float(made.bias) == 1.0


def test_a_restored_mean_goes_on_as_the_first_would_have() -> None:
    made = module(0.0)
    first, second = Averaging(made, 0.95), Averaging(made, 0.95)
    for k in range(40):
        moved(made, float(k))
        first.add()
        if k == 19:
            second.restore(first.mean, first.steps)
        elif k > 19:
            second.add()
    torch.testing.assert_close(second.mean, first.mean, rtol=0, atol=0)
