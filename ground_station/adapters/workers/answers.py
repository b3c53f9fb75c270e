"""Result types of a work item, including the result for a worker that died."""

import pickle
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

Work = TypeVar("Work")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class WorkReturned(Generic[Result]):
    """The work item is done."""

    result: Result


@dataclass(frozen=True, slots=True)
class WorkRaised:
    """The work item raised an exception."""

    error: BaseException


@dataclass(frozen=True, slots=True)
class WorkerTerminated:
    """The worker ended before its work item was done; `reason` is a message for people."""

    reason: str


WorkOutcome = WorkReturned[Result] | WorkRaised | WorkerTerminated


def run_item_catching_errors(
    work_function: Callable[[Work], Result], item: Work
) -> WorkReturned[Result] | WorkRaised:
    """Run `work_function` on an item: its result, or its exception with traceback as note."""
    try:
        return WorkReturned(work_function(item))
    except Exception as error:  # noqa: BLE001 - raised again in the waiting process
        return WorkRaised(_picklable_error(error, traceback.format_exc()))


def _picklable_error(error: Exception, traceback_text: str) -> Exception:
    try:
        same = pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - the exception's constructor may raise anything
        same = RuntimeError(f"{type(error).__name__}: {error}")
    same.add_note(f"in a worker:\n{traceback_text}")
    return same


def unpicklable_result_outcome(error: Exception) -> WorkRaised:
    """Return the outcome for a result that cannot be pickled."""
    return WorkRaised(RuntimeError(f"result cannot be sent: {error}"))
