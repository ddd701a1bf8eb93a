"""Write folders of results, each completely or not."""

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tirefit import __version__
from tirefit.cli.options import CONTEXT, say
from tirefit.door import replaced_inputs
from tirefit.files import WRITING, remove_left, replace_together
from tirefit.results import DataError, InputProblem, TirefitError, UsageError


def check_results(made: Collection[Path], inputs: Iterable[object] = ()) -> None:
    """Check all files that a command may write or replace in folders, before the work.

    Their folders are created later, with the parent folders.

    Args:
        made: the files to write.
        inputs: files that are read, in addition to those that the options name.

    Raises:
        UsageError: a folder cannot be created or written.
        DataError: a file is an input, or one that tirefit did not write.
    """
    remedy = "choose another folder with --out"
    problems, folders = [], dict.fromkeys(path.parent for path in made)
    for directory in folders:
        there = next(p for p in (directory, *directory.absolute().parents) if _is(p))
        reason = ""
        if not there.is_dir():
            what = "it is" if there == directory else f"{there} is"
            reason = f"no folder for the results: {what} a file"
        elif not os.access(there, os.W_OK | os.X_OK):
            reason = f"no permission to write into the folder {there.absolute()}"
        problems += [InputProblem(reason, remedy, str(directory))] * bool(reason)
    UsageError.raise_for(problems)
    for directory in folders:
        remove_left(directory)  # a killed command may have left its result in parts
    check_inputs_kept(made, inputs)
    reason = "it would be replaced, but tirefit did not write it"
    others = [path for path in made if _is(path) and _is_of_others(path, made)]
    remedy += ", or rename the file"
    DataError.raise_for([InputProblem(reason, remedy, str(path)) for path in others])


def names_of(files: Sequence[Path], remedy: str) -> list[str]:
    """The names of the results of files: without folder and ending.

    Raises:
        UsageError: some are the same, and so would be their results.
    """
    names = [Path(file.name.removesuffix(".gz")).stem for file in files]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(f"several input files are named {', '.join(twice)}", remedy)
    return names


def check_inputs_kept(made: Iterable[Path], inputs: Iterable[object] = ()) -> None:
    """Raises DataError for files to write that are inputs of this command.

    Inputs are ``inputs``, and all files that an argument or option names: a new option
    needs no line here.
    """
    DataError.raise_for(replaced_inputs(made, {**_named_files(), "": inputs}))


_WRITTEN = ("out", "truth", "mcap")
"""Options that name files to write."""


def _named_files() -> dict[str, list[object]]:
    """Argument or option of this command -> its values, some of which may name files."""
    context = CONTEXT.get()
    if context is None:  # in a worker: the command has checked before
        return {}
    named: dict[str, list[object]] = {}
    for param in context.command.params:
        given = context.params.get(param.name)
        if param.name in _WRITTEN or given is None:
            continue
        values = given if isinstance(given, list | tuple) else [given]
        # Text may be NAME=FILE,NAME=FILE, as in front=a.json,rear=b.json.
        parts = [p for v in values if isinstance(v, str) for p in re.split("[=,]", v)]
        name = param.opts[0] if param.param_type_name == "option" else str(param.name).upper()
        named[name] = [*values, *parts]
    return named


_OURS = {".json": b'"schema": "tirefit.', ".toml": b"that tirefit fit estimated"}
"""Ending of a file -> what it contains if tirefit wrote it; the others name tirefit."""


def _is_of_others(path: Path, made: Collection[Path]) -> bool:
    """Whether tirefit did not write this file.

    A table, which does not name tirefit, is ours if a document of ours (a JSON file or page
    among ``made``) is beside it.
    """
    try:
        content = path.read_bytes()
    except OSError:
        return False
    if not content.strip() or _OURS.get(path.suffix, b"tirefit") in content:
        return False
    if path.suffix in (".json", ".toml", ".html", ".mcap"):
        return True
    documents = [p for p in made if p.suffix in (".json", ".html") and p.parent == path.parent]
    return bool(documents) and all(not _is(p) or _is_of_others(p, ()) for p in documents)


def _is(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # no permission to read it
        return False


@contextmanager
def staged(directory: Path, known: Collection[str], report: object) -> Iterator[Path]:
    """Context manager: a folder for a result, whose files move to ``directory`` at the end.

    If the block fails or is interrupted, ``directory`` is not changed; it is created if needed.

    Args:
        directory: the folder of the results.
        known: files of an earlier result; those that are not written again are removed,
            as they would be mistaken for files of this one.
        report: the result in words. Where it cannot be written, it is said at least.

    Raises:
        OSError: naming the file that was not written; a note tells what exists.
    """
    created = [path for path in (directory, *directory.parents) if not path.exists()]
    folder = directory
    try:
        directory.mkdir(parents=True, exist_ok=True)
        remove_left(directory)
        folder = Path(tempfile.mkdtemp(prefix=WRITING, dir=directory))
        yield folder
        # The document is moved last, so that the other files belong to it.
        made = sorted(folder.iterdir(), key=lambda path: path.suffix == ".json")
        gone = [directory / name for name in known if not (folder / name).exists()]
        replace_together({directory / path.name: path for path in made}, gone)
    except OSError as error:
        say(str(report))
        path = Path(error.filename or directory)
        # The user does not know the temporary name.
        if path.name.startswith(WRITING):
            path = directory
        elif path.is_relative_to(folder):
            path = directory / path.relative_to(folder)
        named = OSError(error.errno, error.strerror or str(error), str(path))
        there = f"{directory} is as it was before"
        named.add_note(there if directory.is_dir() else f"there is no folder {directory}")
        raise named from None
    finally:
        if folder != directory:
            shutil.rmtree(folder, ignore_errors=True)
        for path in created:
            with suppress(OSError):  # not empty, or not there
                path.rmdir()


def write_result(
    result: Any,
    out: Path,
    known: Sequence[str],
    figures: Mapping[str, str] | Callable[[Path], object],
    page: str = "",
    name: str = "",
    text: str | None = None,
    **how: bool,
) -> list[str]:
    """Write a result with its figures into a folder; print it, and the files.

    Args:
        known: every file that the command may write, in the order of the printed list.
        figures: name of a file -> argument of ``result.plot``, empty for the default; or a
            function that draws into a folder.
        page: name of the page; none if empty.
        name: beginning of the names of files that are named after the data.
        text: the result in words, its summary by default; if empty, nothing is printed.
        how: arguments of ``result.summary``.

    Returns:
        The names of the files written.
    """
    from tirefit.report.canvas import save_picture

    with staged(out, known, result) as folder:
        result.save(folder, *([name] if name else []))
        if callable(figures):
            figures(folder)
        else:
            for file, what in figures.items():
                save_picture(result.plot(what) if what else result.plot(), folder / file)
        if page:
            result.save(folder / page)
        written = [file_name for file_name in known if (folder / file_name).exists()]
    if text != "":
        say(text or result.summary(**how))
        say_written(out, written)
    return written


def say_written(out: Path, written: Iterable[str]) -> None:
    """Print the names of the files that were written into a folder."""
    say(f"wrote to {out}: {', '.join(written)}")


def digest(*asked: Any) -> str:
    """Digest of everything that a result depends on, and of the version of tirefit."""
    return hashlib.sha256(json.dumps([*asked, __version__]).encode()).hexdigest()


def done_before(
    files: Iterable[Path], document: Path, asked: str, record_of: Callable[[Path], Any]
) -> Any:
    """The record of a document if all files of its result are whole, and it answers the same
    as ``asked``, a :func:`digest`; else None.

    Args:
        record_of: makes the record of the path of a document; it raises an error for a
            document that is not as it was written.
    """
    # None is empty, as after a crash of the machine.
    if not all(path.is_file() and path.stat().st_size for path in files):
        return None
    with suppress(TirefitError, OSError, ValueError, LookupError, TypeError, AttributeError):
        content = json.loads(document.read_text(encoding="utf-8"))
        return record_of(document) if content["asked"] == asked else None
    return None


def is_page(path: Path) -> bool:
    """Whether an earlier command wrote this page, and not the user."""
    try:
        return bool(re.search(rb"tirefit\.\w+/\d", path.read_bytes()))
    except OSError:
        return False
