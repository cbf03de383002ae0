"""Conversion of large scans on a cluster of Dask distributed (``pip install slicewalk[cluster]``).

>>> from distributed import Client, LocalCluster
>>> with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
...     report = slicewalk.cluster.convert(
...         "room.las", "whole.slices", client, parts=3, pixel=0.1, units="m", quiet=True
...     )
>>> report["parts"], report["retries"]
(3, 0)

`convert` makes a plan, has the workers convert its parts, joins these as a tree, verifies the result and renames it to
the output, which has the bytes of a single run. Every step is one file in a folder beside the output. The file is named
after everything that determines its content, and is either complete or absent. So a step may run twice without harm, a
step that lost its worker runs again, and after an early end, even by the death of scheduler or client, the next call
resumes the conversion.

Workers read the inputs and write the parts by the same paths as the client, so all of them need a shared folder. An
output in an object store needs such a folder too (``work=``), from which it is uploaded at the end.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import operator
import os
import platform
import queue
import re
import shutil
import time
import urllib.parse
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex, TypeGuard, Unpack

import slicewalk
from slicewalk import _slicewalk
from slicewalk.errors import (
    CancelledError,
    Error,
    LimitError,
    OutputError,
    ParameterError,
    ParameterRangeError,
    ParameterTypeError,
    SlicewalkWarning,
    file_error,
)

if TYPE_CHECKING:
    from slicewalk._options import ClusterOptions, StrPath

try:
    import distributed
    from dask.utils import parse_bytes
except ImportError as _error:
    _message = "slicewalk.cluster needs Dask distributed: pip install 'slicewalk[cluster]'"
    raise ImportError(_message) from _error

__all__ = ["SchedulerLostError", "WorkerLostError", "convert", "discard"]

_Progress = Callable[[str, int, int, str], object]

LEAST_MEMORY = 64 << 20
"""Minimum memory of one part (bytes)."""
BESIDE = 64 << 20
"""Memory that a part may use beyond its budget (bytes)."""
INTERPRETER = 128 << 20
"""Memory used by a worker's interpreter (bytes)."""
_PASSING = 2
_TICK = 0.2
_LOOK = 2.0
# Parts of one plan: their numbers have 16 bits.
_MOST_PARTS = 65_536
_ARCHIVE = b"\x89SLA\r\n\x1a\n"


class WorkerLostError(Error):
    """A step lost its worker too often; `found` is the number of times."""


class SchedulerLostError(Error):
    """The scheduler died and did not come back. Finished steps stay for the next call."""


@dataclass(frozen=True)
class _Job:
    """Parameters shared by all steps. The inputs may be many, so they are in a file beside the plan."""

    work: str
    run: str
    key: str
    count: int
    memory: int | None
    threads: int
    temp_dir: str | None
    stations: str | None
    allow_incomplete: bool
    version: str


@dataclass(frozen=True)
class _Step:
    """Step that makes one archive (a part without members, joined neighbours, or the whole), or checks the whole."""

    name: str
    kind: str
    index: int = 1
    of: int = 1
    members: tuple[str, ...] = ()


def convert(  # noqa: PLR0913
    inputs: StrPath | Iterable[StrPath],
    output: StrPath,
    client: Any,
    *,
    parts: int | None = None,
    memory: int | str | None = "512MiB",
    threads: int = 1,
    fan_in: int = 64,
    failures: int = 16,
    patience: float = 600.0,
    progress: _Progress | None = None,
    force: bool = False,
    work: StrPath | None = None,
    temp_dir: StrPath | None = None,
    **options: Unpack[ClusterOptions],
) -> dict[str, Any]:
    """Convert scans, meshes and splats into one slice archive, in parts on the workers of a Dask cluster.

    Args:
        inputs: as for `slicewalk.convert`: paths that the workers see too, or addresses, for which each worker needs
            credentials in its environment
        output: the archive to write: a file in a folder that the workers see too, or, with `work`, an address
            ``"s3://bucket/key"``, for which the client needs credentials
        client: a connected, synchronous `distributed.Client`
        parts: number of parts; by default four for each thread of the workers
        memory: memory of one part, as for `slicewalk.convert`. A worker with too little memory for that divides what
            it has equally among its threads, so None uses all of it; with less than 64 MiB per thread it refuses
        threads: threads of one part. Dask runs one part at a time on each thread of a worker
        fan_in: most archives that one step joins, at least 2
        failures: how often one step may lose its worker before the conversion fails. Dask itself gives up on a step
            after ``distributed.scheduler.allowed-failures`` + 1 losses (4 by default); until `failures` is exceeded,
            the step is submitted again
        patience: how long the conversion waits while there is no worker at all (s)
        progress: called with stage ("plan", "parts", "merge", "verify", for an address "upload"), amount done, total
            and unit, five times a second; an exception that it raises ends the conversion, as Ctrl-C does
        force: replace an existing archive
        work: folder that client and workers see, for the finished steps; required if the output is an address, and
            invalid otherwise. It needs space for the parts and the whole archive
        temp_dir: folder for temporary data on the workers; by default that of the Dask worker, which removes the files
            of a killed worker
        options: those of `slicewalk.write_plan`, which runs on the client: with ``pixel="auto"`` it reads all points.
            ``stations`` is a file that the workers see too

    Returns:
        ``parts``; ``retries`` (steps that ran again, because their worker was lost or a file could not be read or
        written); ``seconds``; ``skipped`` (steps that an earlier call had finished); ``output``; ``info`` (as
        ``Archive.info``); ``complete``, whether all of the input was read; ``warnings``, the distinct texts of plan and
        parts, also raised as `SlicewalkWarning` unless `quiet`; and ``ran``, a dict for each step: ``step``, ``kind``,
        ``worker``, ``host``, ``pid``, ``seconds``, ``skipped``, ``memory``, and for parts ``complete`` and ``warnings``

    Raises:
        OutputError: the archive exists already
        WorkerLostError: a step lost its worker more than `failures` times, or there was no worker for `patience` s
        SchedulerLostError: the scheduler died and was not back within the client's timeout
        Error: errors of `slicewalk.convert` and `slicewalk.merge` on the workers

    After any error, and even if the client dies, finished steps stay in a hidden folder beside the output or in `work`.
    The next call with the same inputs and options continues from there, unless a local file has changed; `discard`
    removes them. After success nothing is left. Cost beyond the conversion: each page is written, read and checked once
    more per level of the tree, and read once more at the end.

    """
    started = time.monotonic()
    if not isinstance(client, distributed.Client) or client.asynchronous:
        kind = ParameterError if isinstance(client, distributed.Client) else ParameterTypeError
        raise kind(f"client: expected a synchronous distributed.Client, found {client!r}", at="client")
    if parts is not None:
        _check_number("parts", parts, 1, _MOST_PARTS)
    _check_number("threads", threads, 1)
    _check_number("fan_in", fan_in, 2)
    _check_number("failures", failures, 0)
    _check_seconds("patience", patience)
    if progress is not None and not callable(progress):
        raise ParameterTypeError(f"progress: expected a function, or None, found {progress!r}", at="progress")
    if not isinstance(force, bool):
        raise ParameterTypeError(f"force: expected True or False, found {force!r}", at="force")
    scratch = None if temp_dir is None else _path("temp_dir", temp_dir)
    table = options.get("stations")
    stations = None if table is None else os.path.abspath(_path("stations", table))
    digests = [_digest("stations", table), _digest("transform", options.get("transform"))]
    partial = bool(options.get("allow_incomplete"))
    budget = None if memory is None else _bytes(memory)
    target = _checked_target(output, force)
    folder = _work(target, work)
    paths = _paths(inputs)
    plan_options: dict[str, Any] = {**options, "memory": "512MiB" if budget is None else budget}
    count = int(parts or min(_MOST_PARTS, 4 * max(1, sum(client.nthreads().values()))))
    run = uuid.uuid4().hex[:12]
    with _at_work(folder, run, output, force):
        # The parts depend on this too: the plan lacks the stations and knows files by samples of their bytes, and a
        # part that may lack points is of no use to a call that must have all.
        given = json.dumps([slicewalk.__version__, partial, digests, _stamps(paths)])
        plan, planned = _plan(folder, paths, plan_options, given, progress)
        key = hashlib.sha256(f"{given}\n{plan}".encode()).hexdigest()[:16]
        _put(folder / f"{key}-inputs.json", json.dumps(paths))
        _put(folder / f"{key}-plan.json", plan)
        job = _Job(
            work=str(folder),
            run=run,
            key=key,
            count=count,
            memory=budget,
            threads=threads,
            temp_dir=scratch,
            stations=stations,
            allow_incomplete=partial,
            version=slicewalk.__version__,
        )
        steps = _tree(key, count, fan_in)
        driver = _Driver(job, client, steps, failures=failures, patience=patience, progress=progress)
        ran = driver.run()
        retries = driver.passing + _lost(job)
        # Several parts read the same file.
        texts = list(dict.fromkeys(planned + [text for one in ran for text in one.get("warnings", ())]))
        for text in () if options.get("quiet") else texts[len(planned) :]:
            warnings.warn(text, SlicewalkWarning, stacklevel=2)
        _publish(folder / steps[-2].name, target, force, progress)
        info = slicewalk.open(target).info()
        _clean(folder)
    return {
        "parts": count,
        "retries": retries,
        "seconds": time.monotonic() - started,
        "skipped": sum(one["skipped"] for one in ran),
        "output": str(target),
        "info": info,
        "complete": all(one.get("complete", True) for one in ran),
        "warnings": texts,
        "ran": ran,
    }


def discard(output: StrPath, work: StrPath | None = None) -> bool:
    """Remove the finished steps of an interrupted conversion to `output` (with `work`); return whether there were any.

    >>> slicewalk.cluster.discard("whole.slices")
    False
    """
    folder = _work(_target(output), work)
    there = folder.exists()
    _clean(folder)
    return there


# ---- files


def _path(name: str, given: object) -> str:
    """Return a path as text, or raise an error that names the argument."""
    path = os.fspath(given) if isinstance(given, (str, os.PathLike)) else None
    if not isinstance(path, str):
        raise ParameterTypeError(f"{name}: expected a path, found {given!r}", at=name)
    return path


def _digest(name: str, given: object) -> str | None:
    """Return a hash of the file that an argument names; None without one."""
    if given is None:
        return None
    path = _path(name, given)
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise file_error(path, "read", error) from None


def _stamps(paths: list[str]) -> list[tuple[str, int, int]]:
    """Return names, lengths (bytes) and times of change (ns) of the local files that the inputs name."""
    stamps = []
    for name in _slicewalk._input_files([path for path in paths if not _is_address(path)]):
        # The plan reports files that cannot be read.
        with contextlib.suppress(OSError):
            facts = os.stat(name)
            stamps.append((name, facts.st_size, facts.st_mtime_ns))
    return stamps


def _target(output: StrPath) -> Path | str:
    """Return the path of a file with links resolved, or an address in a store."""
    output = _path("output", output)
    if not _is_address(output):
        return Path(os.path.realpath(output))
    parts = urllib.parse.urlsplit(output)
    return Path(urllib.parse.unquote(parts.path)) if parts.scheme == "file" else output


def _check_number(name: str, value: object, least: int, most: int | None = None) -> None:
    """Refuse an argument other than a whole number from `least` to `most`."""
    expected = f"a whole number, {least} or more" if most is None else f"a whole number from {least} to {most}"
    text = f"{name}: expected {expected}, found {value!r}"
    if isinstance(value, bool) or not isinstance(value, SupportsIndex):
        raise ParameterTypeError(text, at=name)
    number = operator.index(value)
    if number < 0 or (most is not None and number > most):
        raise ParameterRangeError(text, at=name)
    if number < least:
        raise ParameterError(text, at=name)


def _check_seconds(name: str, value: object) -> None:
    """Refuse an argument other than a number of seconds, 0 or more."""
    text = f"{name}: expected seconds, 0 or more, found {value!r}"
    if isinstance(value, bool) or not isinstance(value, SupportsFloat):
        raise ParameterTypeError(text, at=name)
    if not float(value) >= 0:
        raise ParameterError(text, at=name)


def _work(target: Path | str, work: StrPath | None) -> Path:
    """Return the folder of the steps: beside the output, where a rename suffices, or in `work` for an address."""
    if isinstance(target, Path):
        if work is not None:
            raise ParameterError("work: is for an output in a store; the steps of a file lie beside it", at="work")
        return target.with_name(f".{target.name}.slicewalk-cluster")
    if work is None:
        message = "work: an output in a store needs a folder for the finished steps that client and workers see"
        raise ParameterError(message, at="work")
    folder = Path(os.path.realpath(_path("work", work)))
    if not folder.is_dir():
        raise ParameterError(f"work: {work}: expected a folder that is there", at="work")
    name = re.sub(r"[^A-Za-z0-9._-]", "_", target.rpartition("/")[2])[:100]
    return folder / f".{name}.{hashlib.sha256(target.encode()).hexdigest()[:8]}.slicewalk-cluster"


def _paths(inputs: StrPath | Iterable[StrPath]) -> list[str]:
    """Return the inputs, with paths made absolute."""
    if isinstance(inputs, (str, os.PathLike)):
        inputs = [inputs]
    if not isinstance(inputs, Iterable):
        raise ParameterTypeError(f"inputs: expected a path, or several, found {inputs!r}", at="inputs")
    given = [_path(f"inputs: item {number}", path) for number, path in enumerate(inputs)]
    if not given:
        raise ParameterError("inputs: expected a path, or several, found none", at="inputs")
    return [path if _is_address(path) else os.path.abspath(path) for path in given]


@contextlib.contextmanager
def _at_work(folder: Path, run: str, output: StrPath, force: bool) -> Iterator[None]:
    """Make the folder of the steps; remove it if an error comes before the first step is finished."""
    if not folder.parent.is_dir():
        raise OutputError(f"{output}: its folder does not exist; make it first", path=str(output))
    is_own = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield
    except (Error, OSError, TypeError) as error:
        if not folder.exists() and isinstance(error, OSError):
            # A faster call for the same output removed the steps that both shared.
            _checked_target(output, force)
            message = f"{output}: another conversion to it ended meanwhile; call again"
            raise OutputError(message, path=str(output)) from error
        if not isinstance(error, (WorkerLostError, SchedulerLostError, CancelledError)):
            # The next call makes a new plan, because the inputs may have changed.
            _remove(folder / "plan.json")
            if is_own and folder.exists() and not _is_worth_keeping(folder, run):
                _clean(folder)
        raise


def _is_worth_keeping(folder: Path, run: str) -> bool:
    """Return whether a step is finished, or another call is running."""

    def counts(name: str) -> bool:
        return run not in name if name.startswith("began-") else name[0] != "." and name.endswith(".slices")

    return any(counts(path.name) for path in folder.iterdir())


def _is_address(path: StrPath) -> TypeGuard[str]:
    """Return whether an input is in an object store or on a web server."""
    return isinstance(path, str) and re.match(r"[A-Za-z][A-Za-z0-9+.-]+://", path) is not None


def _checked_target(output: StrPath, force: bool) -> Path | str:
    """Return the path of `output` with links resolved, or its address; raise if no archive may be written there."""
    target = _target(output)
    if isinstance(target, str):
        _slicewalk._check_output(target, force)
        return target

    def refuse(reason: str, hint: str) -> OutputError:
        return OutputError(f"{output}: {reason}; {hint}", path=str(output), reason=reason, hint=hint)

    if target.exists():
        if not target.is_file():
            raise refuse("is not a regular file", "choose another name")
        if not force:
            raise refuse("exists already", "force=True replaces it")
        with target.open("rb") as file:
            if file.read(8) not in (_ARCHIVE, b""):
                raise refuse("exists and is not a slice archive, so it is not replaced", "choose another name")
    return target


def _put(path: Path, text: str) -> None:
    """Write a small file, all or nothing."""
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:8]}.part")
    part.write_text(text)
    os.replace(part, path)


def _remove(path: Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        path.unlink()


def _clean(work: Path) -> None:
    """Remove the folder, even while a worker that was presumed dead still writes to it."""
    for _ in range(20):
        shutil.rmtree(work, ignore_errors=True)
        if not work.exists():
            return
        time.sleep(0.1)


def _publish(whole: Path, target: Path | str, force: bool, progress: _Progress | None) -> None:
    """Rename the whole archive, which is already synced and verified, to the output."""
    if isinstance(target, str):
        _slicewalk._upload_archive(whole, target, force=force, progress=progress)
        return
    _checked_target(target, force)
    if force:
        with contextlib.suppress(FileNotFoundError):
            # At most as open as the archive that it replaces.
            mode = whole.stat().st_mode & 0o777
            if (narrower := mode & (target.stat().st_mode | 0o600)) != mode:
                whole.chmod(narrower)
        os.replace(whole, target)
    else:
        try:
            os.link(whole, target)
        except FileExistsError:
            _checked_target(target, force)
            raise
        except OSError:
            # The file system has no hard links.
            os.rename(whole, target)
    if os.name == "posix":
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _plan(
    work: Path, paths: list[str], options: dict[str, Any], given: str, progress: _Progress | None
) -> tuple[str, list[str]]:
    """Return the plan, that of an earlier call for the same work or a new one, and the warnings already raised.

    `given` tells version and content of the inputs.
    """
    plan, request = work / "plan.json", work / "request.json"
    wanted = json.dumps([given, paths, options], sort_keys=True, default=str)
    reads_points = (
        options.get("pixel", "auto") == "auto"
        or options.get("tolerance") == "auto"
        or options.get("colour", "off") != "off"
    )
    with contextlib.suppress(FileNotFoundError):
        # A plan from headers alone takes little time, and making it again also notices changed objects.
        if reads_points and request.read_text() == wanted:
            return plan.read_text(), []
    _remove(plan)
    tell = progress and (lambda _stage, done, total, unit: progress("plan", done, total, unit))
    facts = slicewalk.write_plan(tuple(paths), plan, progress=tell, **options)
    _put(request, wanted)
    return plan.read_text(), list(dict.fromkeys(facts["warnings"]))


# ---- steps


def _tree(key: str, count: int, fan_in: int) -> list[_Step]:
    """Return all steps, leaves first; the last two are the whole and its check."""

    def name(level: int, index: int, of: int) -> str:
        return f"{key}-{level}-{index:05}-of-{of:05}.slices"

    level, of = 0, count
    steps = [_Step(name(0, index, count), "part", index, count) for index in range(1, count + 1)]
    below = [step.name for step in steps]
    while of > fan_in:
        level, of = level + 1, -(-of // fan_in)
        ends = [number * len(below) // of for number in range(of + 1)]
        nodes = [
            _Step(name(level, number + 1, of), "merge", number + 1, of, tuple(below[ends[number] : ends[number + 1]]))
            for number in range(of)
        ]
        steps += nodes
        below = [node.name for node in nodes]
    whole = _Step(f"{key}-whole.slices", "merge", members=tuple(below))
    return [*steps, whole, _Step(f"{key}-verify", "verify", members=(whole.name,))]


def _run(job: _Job, step: _Step) -> dict[str, Any]:
    """Run one step on a worker: make its archive unless a sound one exists. May run twice, even at the same time."""
    started = time.monotonic()
    if slicewalk.__version__ != job.version:
        message = f"worker with slicewalk {slicewalk.__version__}, client with {job.version}; install the same version"
        raise Error(message, found=slicewalk.__version__, expected=job.version)
    work = Path(job.work)
    began = work / f"began-{job.run}-{step.name}-{uuid.uuid4().hex[:8]}"
    began.touch()
    worker, scratch, memory = _place(job)
    try:
        skipped, facts = _make(job, step, memory, scratch)
    finally:
        # Files that stay come from workers that died.
        _remove(began)
    return {
        "step": step.name,
        "kind": step.kind,
        "worker": worker,
        "host": platform.node(),
        "pid": os.getpid(),
        "seconds": time.monotonic() - started,
        "skipped": skipped,
        "memory": memory if step.kind == "part" else None,
        **facts,
    }


def _make(job: _Job, step: _Step, memory: int, scratch: str | None) -> tuple[bool, dict[str, Any]]:
    """Make the archive of a step; return whether it existed, and for a part its completeness and warnings."""
    work, watch = Path(job.work), _Watch(job)
    target = work / step.name
    if step.kind == "verify":
        for finding in slicewalk.open(work / step.members[0]).verify(watch):
            raise finding
        return False, {}
    facts = work / f"{step.name}.json"
    if _is_sound(target, step, watch):
        if step.kind != "part":
            return True, {}
        with contextlib.suppress(FileNotFoundError):
            return True, json.loads(facts.read_text())
    if step.kind == "part":
        report = slicewalk.convert(
            json.loads((work / f"{job.key}-inputs.json").read_text()),
            target,
            progress=watch,
            plan=work / f"{job.key}-plan.json",
            shard=(step.index, step.of),
            memory=memory,
            threads=job.threads,
            temp_dir=job.temp_dir or scratch,
            stations=job.stations,
            allow_incomplete=job.allow_incomplete,
            quiet=True,
            force=True,
        )
        lacks = {"complete": report["complete"], "warnings": report["warnings"]}
        _put(facts, json.dumps(lacks))
        return False, lacks
    members = tuple(work / name for name in step.members)
    part = None if step.name.endswith("-whole.slices") else (step.index, step.of)
    slicewalk.merge(members, target, part=part, progress=watch, force=True)
    return False, {}


def _is_sound(target: Path, step: _Step, watch: _Watch) -> bool:
    """Return whether an earlier attempt left the complete archive of this step."""
    if not target.exists():
        return False
    try:
        archive = slicewalk.open(target)
        shard = archive.info().get("shard")
        is_whole = step.name.endswith("-whole.slices")
        found = (1, 1) if shard is None and is_whole else shard and (shard["index"], shard["count"])
        return found == (step.index, step.of) and not archive.verify(watch)
    except CancelledError:
        raise
    except Error:
        return False


class _Watch:
    """Progress callback on a worker that cancels the work when the client asks for it."""

    def __init__(self, job: _Job) -> None:
        self.stop = Path(job.work, f"stop-{job.run}")
        self.looked = 0.0

    def __call__(self, *_: object) -> None:
        now = time.monotonic()
        if now - self.looked > 0.5:
            self.looked = now
            if self.stop.exists() or not self.stop.parent.exists():
                raise CancelledError("the client ended the conversion")


def _place(job: _Job) -> tuple[str, str | None, int]:
    """Return address and scratch folder of this worker, and the memory of one of its parts (bytes)."""
    try:
        worker = distributed.get_worker()
    except ValueError:
        return "here", None, job.memory or 512 << 20
    limit, lanes = worker.memory_manager.memory_limit, worker.state.nthreads
    if not limit:
        return worker.address, worker.local_directory, job.memory or 512 << 20
    # Dask pauses a worker at 80 % of its limit.
    share = (int(limit * 0.8) - INTERPRETER) // lanes - BESIDE
    memory = share if job.memory is None else min(job.memory, share)
    if memory < LEAST_MEMORY:
        least = (lanes * (LEAST_MEMORY + BESIDE) + INTERPRETER) / 0.8 / (1 << 20)
        what = f"memory of the worker {worker.address} with {lanes} threads"
        hint = f"start workers with {least:.0f} MiB or more, or fewer threads"
        found = f"{limit >> 20} MiB"
        raise LimitError(f"{what}: {found}; {hint}", path=worker.address, found=found, expected=least, hint=hint)
    return worker.address, worker.local_directory, memory


def _lost(job: _Job) -> int:
    """Return how many attempts ended because their worker died."""
    return sum(1 for path in Path(job.work).iterdir() if path.name.startswith(f"began-{job.run}-"))


def _bytes(memory: object) -> int:
    message = f'memory: expected a whole number of bytes, or a text such as "512MiB", found {memory!r}'
    if isinstance(memory, str):
        try:
            return int(parse_bytes(memory))
        except ValueError:
            raise ParameterError(message, at="memory") from None
    if isinstance(memory, bool) or not isinstance(memory, SupportsIndex):
        raise ParameterTypeError(message, at="memory")
    return operator.index(memory)


# ---- the client's side


class _Driver:
    """Submits every step that can run to the scheduler until all are done."""

    def __init__(  # noqa: PLR0913
        self,
        job: _Job,
        client: Any,
        steps: Sequence[_Step],
        *,
        failures: int,
        patience: float,
        progress: _Progress | None,
    ) -> None:
        self.job, self.client, self.failures, self.progress = job, client, failures, progress
        self.patience, self.looked, self.alone_since = patience, time.monotonic(), math.inf
        self.steps = {step.name: step for step in steps}
        self.above = {member: step for step in steps for member in step.members}
        self.waits = {step.name: len(step.members) for step in steps}
        self.done: dict[str, dict[str, Any]] = {}
        self.losses = dict.fromkeys(self.steps, 0)
        self.attempts = dict.fromkeys(self.steps, 0)
        self.futures: dict[str, Any] = {}
        self.ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.passing = 0

    def run(self) -> list[dict[str, Any]]:
        """Run all steps. After an exception, workers stop soon."""
        try:
            self._submit(step for step in self.steps.values() if not step.members)
            while len(self.done) < len(self.steps):
                self._tell()
                try:
                    self._settle(self.ended.get(timeout=_TICK))
                except queue.Empty:
                    self._look_for_workers()
            self._tell()
        except BaseException:
            self._stop()
            raise
        return [self.done[name] for name in self.steps]

    def _submit(self, steps: Iterable[_Step]) -> None:
        for step in steps:
            attempt = self.attempts[step.name] = self.attempts[step.name] + 1
            key = f"slicewalk-{self.job.run}-{step.name}-{attempt}"
            # Merges go first: other steps wait for them, and the last steps take longest.
            priority = {"part": 0, "merge": 1, "verify": 2}[step.kind]
            future = self.client.submit(_run, self.job, step, key=key, pure=False, priority=priority)
            self.futures[step.name] = future
            future.add_done_callback(lambda future, name=step.name: self.ended.put((name, future)))

    def _settle(self, ended: tuple[str, Any]) -> None:
        name, future = ended
        if name not in self.futures or self.futures[name] is not future:
            return None  # an attempt that another one has replaced
        step = self.steps[name]
        if future.status == "finished":
            try:
                self.done[name] = future.result()
            except Exception:
                # The worker died with the result, but its archive exists.
                return self._submit([step])
            del self.futures[name]
            if (above := self.above.get(name)) is not None:
                self.waits[above.name] -= 1
                if self.waits[above.name] == 0:
                    self._submit([above])
            return None
        if future.status != "error":
            return self._again()
        error = future.exception()
        if isinstance(error, distributed.scheduler.KilledWorker):
            self.losses[name] += error.allowed_failures + 1
            if self.losses[name] > self.failures:
                message = (
                    f"{step.kind} {step.index} of {step.of}: lost its worker {self.losses[name]} times, most likely "
                    "for want of memory; give the workers more, or make more parts, and call again: what is done stays"
                )
                raise WorkerLostError(message, found=str(self.losses[name])) from error
            return self._submit([step])
        if isinstance(error, OSError) and not isinstance(error, OutputError) and self.attempts[name] <= _PASSING:
            self.passing += 1
            return self._submit([step])
        raise error

    def _look_for_workers(self) -> None:
        """Give up if there has been no worker for too long."""
        now = time.monotonic()
        if now - self.looked < _LOOK or self.client.status != "running":
            return
        self.looked = now
        if self.client.nthreads():
            self.alone_since = math.inf
        else:
            self.alone_since = min(self.alone_since, now)
        if now - self.alone_since >= self.patience:
            message = f"no worker for {self.patience:g} s; start workers and call again with the same arguments"
            raise WorkerLostError(message, hint="start workers and call again")

    def _again(self) -> None:
        """Submit unfinished steps again once another scheduler has taken the address of the lost one."""
        while self.client.status == "connecting":
            self._tell()
            time.sleep(_TICK)
        if self.client.status != "running":
            done = f"{len(self.done)} of {len(self.steps)} steps are done"
            message = f"the scheduler is gone, {done}; start another one and call again with the same arguments"
            raise SchedulerLostError(message, hint="call again with the same arguments")
        names, self.futures = list(self.futures), {}
        self._submit(self.steps[name] for name in names)

    def _tell(self) -> None:
        if self.progress is None:
            return
        for stage, kind, unit in (
            ("parts", "part", "parts"),
            ("merge", "merge", "archives"),
            ("verify", "verify", "archives"),
        ):
            total = sum(step.kind == kind for step in self.steps.values())
            done = sum(one["kind"] == kind for one in self.done.values())
            if done < total or stage == "verify":
                self.progress(stage, done, total, unit)
                return

    def _stop(self) -> None:
        with contextlib.suppress(OSError):
            Path(self.job.work, f"stop-{self.job.run}").touch()
        if self.client.status != "running":
            return
        with contextlib.suppress(Exception):
            self.client.cancel(list(self.futures.values()), force=True)
