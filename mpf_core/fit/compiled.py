"""All loops that a fit and its extraction call, compiled before anything is timed."""

from __future__ import annotations

from types import ModuleType

import torch

from mpf_core.errors import Cancelled
from mpf_core.field import plain
from mpf_core.field.pointwise import compile_all, functions, functions_of_theta, give_up
from mpf_core.progress import CancelCheck


def prepare(kept: torch.dtype, cancel: CancelCheck | None = None) -> ModuleType:
    """The functions that work on arrays kept in that type (`pointwise`), once all is compiled.

    Raises Cancelled when `cancel` says so, which is asked before each of the small compilations.
    """
    functions_of_theta(cancel)
    found = functions(kept, cancel)
    if found is not plain:
        from mpf_core.fit import adjoints  # loads the compiler, which may not be there

        try:
            compile_all(adjoints.compilations(), cancel)
        except Cancelled:
            raise
        except Exception as error:  # a fit can do without, as `pointwise` has it
            give_up(error)
            return plain
    return found
