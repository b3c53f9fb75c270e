"""What a worker answers of a piece of work, and what is said for one that cannot answer."""

import pickle
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

Work = TypeVar("Work")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class WorkReturned(Generic[Result]):
    """What a worker says of a piece that is done."""

    result: Result


@dataclass(frozen=True, slots=True)
class WorkRaised:
    """What a worker says of a piece that raised."""

    error: BaseException


@dataclass(frozen=True, slots=True)
class WorkerDied:
    """A worker ended before its piece was done; `why` in a person's words."""

    why: str


Answer = WorkReturned[Result] | WorkRaised | WorkerDied


def answer_of(do: Callable[[Work], Result], piece: Work) -> WorkReturned[Result] | WorkRaised:
    """What a worker answers: the result, or what was raised, with its traceback as a note."""
    try:
        return WorkReturned(do(piece))
    except Exception as error:  # noqa: BLE001 - raised again by who waits for the answer
        return WorkRaised(_portable(error, traceback.format_exc()))


def _portable(error: Exception, where: str) -> Exception:
    try:
        same = pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever its own constructor makes of it
        same = RuntimeError(f"{type(error).__name__}: {error}")
    same.add_note(f"in a worker:\n{where}")
    return same


def not_sent(error: Exception) -> WorkRaised:
    """The answer in place of a result that cannot be pickled."""
    return WorkRaised(RuntimeError(f"a result that cannot be sent: {error}"))
