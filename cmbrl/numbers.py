"""Numbers and arrays from outside: each is what it claims to be, or a UserError says what to give instead.

numpy converts text, times and complex numbers without a word or with a mere warning; a wrong column of a log would then
become a wrong robot. Everything that a caller hands over as a number goes through here.
"""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Collection
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.text import shortened

LARGEST = 2**31 - 1  #: the core counts in 32 bits
_KINDS = "biuf"  # of numpy: truth values, whole numbers, floating point
_OTHER = {
    "U": "text",
    "S": "text",
    "M": "times",
    "m": "durations",
    "c": "complex numbers",
    "O": "objects",
    "V": "records",
}


def whole(value: Any, name: str, least: int = 1, most: int = LARGEST) -> int:
    """``value`` as an int; raises UserError unless it is a whole number of an integer type in [least, most]."""
    try:
        number = None if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not least <= number <= most:
        raise UserError(f"{name} = {shown(value)}: give a whole number from {least} to {most}")
    return number


def real(value: Any, name: str, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf) -> float:
    """``value`` (or the one entry of an array) as a float; raises UserError unless it is above ``above`` and in
    [least, most].

    Infinity is allowed where no bound excludes it; NaN never is.
    """
    try:
        number = math.nan if isinstance(value, bool | np.bool_) else float(real_array(value, name).item())
    except ValueError:  # UserError of real_array, and an array with several entries
        number = math.nan
    if not (above < number and least <= number <= most):
        bounds = [f"above {above:g}"] * (above > -math.inf) + [f"at least {least:g}"] * (least > -math.inf)
        bounds += [f"at most {most:g}"] * (most < math.inf)
        raise UserError(f"{name} = {shown(value)}: give a number{' ' * bool(bounds)}{' and '.join(bounds)}")
    return number


def switch(value: Any, name: str) -> bool:
    """``value`` as a bool; raises UserError for what merely can be read as one, such as the text "no"."""
    if isinstance(value, bool | np.bool_) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    raise UserError(f"{name} = {shown(value)}: give True or False")


def real_array(value: Any, name: str) -> np.ndarray:
    """``value`` as a C-contiguous float64 array of its own shape.

    Raises UserError for text, times, complex numbers, objects, ragged lists, and arrays with masked entries. NaN and
    infinity pass: what they mean depends on the place.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous:  # as loops give it
        return value
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            array = np.asarray(value)
            kind = array.dtype.kind
            if kind in _KINDS and not np.ma.is_masked(value):
                return np.asarray(array, dtype=np.float64, order="C")
    except Exception as error:  # a foreign type converts itself, and may raise anything
        raise UserError(f"{name} is not an array of numbers ({shortened(str(error), 100)})") from None
    if kind in _KINDS:
        raise UserError(f"{name} has masked entries; fill or remove them")
    raise UserError(f"{name} has {_OTHER.get(kind, 'no numbers')} ({array.dtype}); give real numbers")


def one_of(value: Any, choices: Collection[str], name: str) -> str:
    """``value`` if it is among ``choices``; raises UserError with the nearest."""
    if isinstance(value, str) and value in choices:
        return value
    raise UserError(f"unknown {name} {shown(value)}: {did_you_mean(value if isinstance(value, str) else '', choices)}")


def names(value: Any, name: str) -> tuple[str, ...]:
    """A sequence of texts as a tuple; raises UserError for anything else, a single text included."""
    if isinstance(value, np.ndarray):
        value = value.tolist() if value.ndim == 1 and value.dtype.kind in "UO" else None
    if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
        raise UserError(f"{name} = {shown(value)}: give a list of names")
    return tuple(map(str, value))


def shown(value: Any) -> str:
    """``value`` as in a message: short, whatever it is."""
    try:
        return shortened(repr(value), 60)
    except Exception:  # a number of too many digits, a list nested too deeply, or a foreign type
        return f"a {type(value).__name__}"
