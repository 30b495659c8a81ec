"""Pickles as LeRobot's policy server writes and reads them, of which nothing is ever unpickled; called by `lerobot`.

What arrives is read as a tree: names stay names, and a call that a pickle asks for is noted, not made.
"""

import pickle
import pickletools
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ..agent.protocol import violation
from ..agent.verdicts import PolicyFailed, VerdictCode

_HELPERS: Final = "lerobot.async_inference.helpers"
_OPCODES_MAX: Final = 200_000
"""Of an answer; about a hundred write one action."""
_LENGTH_MAX: Final = 1000
"""Of an answer in actions, and of an action."""
_DTYPES: Final = {
    f"torch {name}Storage": np.dtype(code)
    for name, code in {"Float": "<f4", "Double": "<f8", "Half": "<f2", "Long": "<i8", "Int": "<i4"}.items()
}
_T = TypeVar("_T")
_MARK: Final = object()
_VALUES: Final = frozenset(
    {
        *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"),
        *("BINUNICODE", "SHORT_BINUNICODE", "BINBYTES", "SHORT_BINBYTES"),
    }
)
_CONSTANTS: Final = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}


@dataclass(eq=False)
class Call:
    """What a pickle would have called, and the state that it would have set."""

    name: object
    arguments: object
    state: object = None


def write_call(name: str, *arguments: object) -> bytes:
    """Return a pickle whose reader makes an object of one of LeRobot's classes of helpers."""
    head = pickle.PROTO + b"\x03" + pickle.GLOBAL + f"{_HELPERS}\n{name}\n".encode()
    return head + pickle.dumps(arguments, protocol=3)[2:-1] + pickle.REDUCE + pickle.STOP


def read_actions(data: bytes, timestep: int) -> NDArray[np.generic]:
    """Return the actions of a pickled list of LeRobot's `TimedAction`, shape [actions, components].

    Args:
        data: the pickle.
        timestep: number of the question; the actions have it and those that follow.

    Raises:
        PolicyFailed: bad_action_type, or protocol_violation where it is anything else, or answers another question.
    """
    left = iter(range(_OPCODES_MAX))
    try:
        actions = _as(list, _read_tree(BytesIO(data), left))
        rows = [_read_action(action, timestep + place, left) for place, action in enumerate(actions[:_LENGTH_MAX])]
    except (ValueError, IndexError, KeyError, TypeError) as error:
        raise violation(f"Expected a list of LeRobot's TimedAction, got another pickle: {error!r:.200}.") from None
    if not rows or len({row.shape for row in rows}) > 1:
        raise violation(f"Expected actions of one shape, got {sorted({row.shape for row in rows})!r:.80}.")
    return np.stack(rows)


def _read_action(action: object, timestep: int, left: Iterator[int]) -> NDArray[np.generic]:
    state = _as(dict, _check_call(f"{_HELPERS} TimedAction", action).state)
    answered = _as(int, state["timestep"])
    if answered != timestep:
        raise violation(
            f"Expected the answer to question {timestep}, got that to question {answered!r:.40}. LeRobot's server "
            "answers one client at a time: is there another one?"
        )
    return _read_tensor(state["action"], left)


def _read_tensor(value: object, left: Iterator[int]) -> NDArray[np.generic]:
    """Return the numbers of a pickled tensor of one axis, as torch writes it."""
    call = _check_call("torch._utils _rebuild_tensor_v2", value)
    storage, offset, size, stride, *_ = _as(tuple, call.arguments)
    numbers = _read_storage(storage, left)
    (length,), (step,) = _as(tuple, size), _as(tuple, stride)
    first, length, step = (_as(int, number) for number in (offset, length, step))
    if not (0 < length <= _LENGTH_MAX and first >= 0 <= step and first + (length - 1) * step < len(numbers)):
        raise ValueError(f"{length} numbers from {first} in steps of {step}, of {len(numbers)}")
    return numbers[first + step * np.arange(length)]


def _read_storage(value: object, left: Iterator[int]) -> NDArray[np.generic]:
    """Return the numbers that torch saved in its form before archives: five pickles, their count, and the numbers."""
    (data,) = _as(tuple, _check_call("torch.storage _load_from_bytes", value).arguments)
    stream = BytesIO(_as(bytes, data))
    _, _, _, storage, _ = (_read_tree(stream, left) for _ in range(5))
    kind = _as(str, _as(tuple, _check_call("persistent", storage).arguments)[1])
    if kind not in _DTYPES:
        raise PolicyFailed(
            VerdictCode.BAD_ACTION_TYPE, f"Expected a tensor of {', '.join(_DTYPES)}, got one of {kind!r:.80}."
        )
    return np.frombuffer(stream.read()[8:], _DTYPES[kind])


def _read_tree(stream: BytesIO, left: Iterator[int]) -> object:
    """Return what a pickle builds, with calls in place of objects; the stream is left behind it.

    Args:
        stream: at the pickle.
        left: gives as many numbers as the answer may have further instructions.

    Raises:
        PolicyFailed: protocol_violation.
        ValueError, IndexError, KeyError, TypeError: it is none that LeRobot and torch write.
    """
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    for opcode, argument, _ in pickletools.genops(stream):
        if next(left, None) is None:
            raise violation(f"Expected an answer of at most {_OPCODES_MAX} instructions, got a longer one.")
        match opcode.name:
            case "PROTO" | "FRAME" | "STOP":
                pass
            case name if name in _VALUES:
                stack.append(argument)
            case name if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case "MARK":
                stack.append(_MARK)
            case "EMPTY_LIST":
                stack.append([])
            case "EMPTY_DICT":
                stack.append({})
            case "GLOBAL":
                stack.append(argument)
            case "STACK_GLOBAL":
                stack[-2:] = [" ".join(stack[-2:])]
            case "MEMOIZE":
                memo[len(memo)] = stack[-1]
            case "BINPUT" | "LONG_BINPUT":
                memo[cast("int", argument)] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(memo[cast("int", argument)])
            case "TUPLE1" | "TUPLE2" | "TUPLE3" as name:
                count = int(name[-1])
                stack[-count:] = [tuple(stack[-count:])]
            case "TUPLE":
                stack.append(tuple(_above_mark(stack)))
            case "APPEND":
                item = stack.pop()
                _as(list, stack[-1]).append(item)
            case "APPENDS":
                items = list(_above_mark(stack))
                _as(list, stack[-1]).extend(items)
            case "SETITEM":
                key, value = stack.pop(-2), stack.pop()
                _as(dict, stack[-1])[_as(str, key)] = value
            case "SETITEMS":
                items = list(_above_mark(stack))
                keys = [_as(str, key) for key in items[::2]]
                _as(dict, stack[-1]).update(zip(keys, items[1::2], strict=True))
            case "REDUCE" | "NEWOBJ":
                stack[-2:] = [Call(*stack[-2:])]
            case "BINPERSID":
                stack[-1:] = [Call("persistent", stack[-1])]
            case "BUILD":
                state = stack.pop()
                _as(Call, stack[-1]).state = state
            case name:
                raise ValueError(f"the instruction {name}")
    (tree,) = stack
    return tree


def _above_mark(stack: list[Any]) -> Iterator[Any]:
    """Take what lies above the last mark, and the mark."""
    place = len(stack) - 1
    while stack[place] is not _MARK:
        place -= 1
        if place < 0:
            raise ValueError("an end without its mark")
    items = stack[place + 1 :]
    del stack[place:]
    return iter(items)


def _check_call(name: str, value: object) -> Call:
    """Return a value that is a call of this name."""
    call = _as(Call, value)
    if _as(str, call.name) != name:
        raise ValueError(f"{call.name!r:.80} in place of {name}")
    return call


def _as(kind: type[_T], value: object) -> _T:
    if not isinstance(value, kind):
        raise TypeError(f"{type(value).__name__} in place of {kind.__name__}")
    return value
