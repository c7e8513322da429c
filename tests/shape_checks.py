"""Shape and type checks in the first calls of each function per test file; more would slow the tests down."""

import operator
import os
import sys
from collections import Counter
from collections.abc import Callable
from functools import wraps
from typing import Any

from beartype import beartype

IS_ON = os.environ.get("PLR_JAX_CHECK_SHAPES") == "1"  # CI sets this; stack traces then contain frames of checks
CALLS = 5
_calls: Counter = Counter()
_skipped: list[Callable] = []


def in_first_calls(stub: Callable) -> Callable:
    """Return the checker of a function; jaxtyping calls this with a stub of the function's signature.

    Signatures with ``Self`` are not checked, since beartype knows ``Self`` only in classes that it decorates.
    """
    if "Self" in str(stub.__annotations__):
        return stub
    name = (stub.__module__, stub.__qualname__)
    check = None

    @wraps(stub)
    def checked(*args: Any, **kwargs: Any) -> Any:
        nonlocal check
        _calls[name] += 1
        if _calls[name] > 2 * CALLS:  # nested functions cannot be marked as not to check
            return stub(*args, **kwargs)
        if _calls[name] == 2 * CALLS:  # each call checks twice: arguments, then arguments and result
            _skip(*name)
        check = check or beartype(stub)  # takes a millisecond, also for each new closure of a nested function
        return check(*args, **kwargs)

    return checked


def begin_file() -> None:
    """Check all functions again."""
    for function in _skipped:
        vars(function).pop("__no_type_check__", None)
    _skipped.clear()
    _calls.clear()


def _skip(module: str, name: str) -> None:
    if "<locals>" not in name:
        function = operator.attrgetter(name)(sys.modules[module])
        function = function.fget if isinstance(function, property) else function
        if callable(function):
            vars(function)["__no_type_check__"] = True
            _skipped.append(function)
