"""Pieces of work side by side; a worker that is killed costs its piece only."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from ground_station.adapters.workers.answers import Answer, WorkRaised, WorkReturned

Work = TypeVar("Work")
Result = TypeVar("Result")
Given = TypeVar("Given", contravariant=True)


@dataclass(frozen=True, slots=True)
class Workers:
    """Who works: `jobs` processes of this machine, or instead of them a Ray cluster."""

    jobs: int = 1
    cluster: str | None = None
    """`local` (started here, ended with the work), `auto` (the one that this machine belongs to)
    or an address.
    """


@dataclass(frozen=True, slots=True)
class PieceDone(Generic[Result]):
    """A piece that is done; `index` counts the pieces from 0, as they were given."""

    index: int
    result: Result


@dataclass(frozen=True, slots=True)
class PieceLost(Generic[Work]):
    """A piece whose worker died, and whose second worker died too."""

    index: int
    piece: Work
    why: str


class Crew(Protocol[Given, Result]):
    """Workers that do the same to every piece."""

    @property
    def size(self) -> int:
        """How many pieces may be under way at once."""
        ...

    def begin(self, index: int, piece: Given) -> None:
        """Give a piece to a worker that is free, or to a new one."""
        ...

    def ended(self) -> list[tuple[int, Answer[Result]]]:
        """Wait until a piece has ended; all that have, with their index."""
        ...

    def close(self) -> None:
        """End all workers, those too that are at work."""
        ...


def side_by_side(
    work: Iterable[Work],
    do: Callable[[Work], Result],
    workers: Workers,
    say: Callable[[str], None] = lambda words: None,
) -> Generator[PieceDone[Result] | PieceLost[Work], None, None]:
    """`do` of every piece, begun in their order, given back as they end.

    `do`, pieces and results are pickled; with one job and no cluster nothing is, and all is done in
    this process. A piece whose worker dies (SIGKILL, out of memory) is tried once more, and lost
    where it dies again; no other piece is touched. What `do` raises is raised here. Whatever ends
    this process, Ctrl-C and SIGTERM too, ends the workers. Pieces are taken from `work` as they are
    begun, so it may be endless.

    Raises: LeewayError where the cluster cannot be reached.
    """
    if workers.cluster is None and workers.jobs == 1:
        for index, piece in enumerate(work):
            yield PieceDone(index, do(piece))
        return
    crew = _crew_of(do, workers)
    try:
        yield from _worked(iter(enumerate(work)), crew, say)
    finally:
        crew.close()


def _crew_of(do: Callable[[Work], Result], workers: Workers) -> Crew[Work, Result]:
    if workers.cluster is not None:
        from ground_station.adapters.workers.ray_crew import RayCrew

        return RayCrew(do, workers.cluster)
    from ground_station.adapters.workers.process_crew import ProcessCrew

    return ProcessCrew(do, workers.jobs)


def _worked(
    fresh: Iterator[tuple[int, Work]], crew: Crew[Work, Result], say: Callable[[str], None]
) -> Iterator[PieceDone[Result] | PieceLost[Work]]:
    under_way: dict[int, Work] = {}
    again: deque[tuple[int, Work]] = deque()
    deaths: dict[int, str] = {}

    def begin() -> None:
        while len(under_way) < crew.size:
            following = again.popleft() if again else next(fresh, None)
            if following is None:
                return
            crew.begin(*following)
            under_way[following[0]] = following[1]

    begin()
    while under_way:
        told: list[PieceDone[Result] | PieceLost[Work]] = []
        error: BaseException | None = None
        for index, answer in crew.ended():
            piece = under_way.pop(index)
            if isinstance(answer, WorkReturned):
                told.append(PieceDone(index, answer.result))
            elif isinstance(answer, WorkRaised):
                error = answer.error
            elif index in deaths:
                told.append(PieceLost(index, piece, f"{deaths[index]}; again: {answer.why}"))
            else:
                deaths[index] = answer.why
                again.append((index, piece))
                say(f"{answer.why}: its piece of work is tried once more")
        if error is None:
            begin()  # first: nobody is idle while the caller looks at what has ended
        yield from told
        if error is not None:
            raise error
