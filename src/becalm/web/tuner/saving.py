"""Save cleaned files and reports with the command line in a subprocess, so that the command gives the same files."""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import NamedTuple

from becalm.errors import NOT_DESCRIBED, OutputError
from becalm.files.registry import ENDINGS
from becalm.installation import MODULE, environment
from becalm.web.tuner.naming import stem_of

_BLOCK = 1 << 18  # bytes that are read at once


class CleaningJob(NamedTuple):
    """A file to clean, with its recipe."""

    file: Path
    recipe: str  # TOML
    group: str | None = None


class TemporaryOutput:
    """A finished file in a private folder; `close` removes both."""

    def __init__(self, folder: tempfile.TemporaryDirectory[str], path: Path, name: str) -> None:
        self._folder, self.path, self.name = folder, path, name
        self.bytes = path.stat().st_size

    async def blocks(self) -> AsyncIterator[bytes]:
        """Yield the bytes of the file, and then remove it, even if the reader stops early."""
        try:
            with self.path.open("rb") as stream:
                while block := await asyncio.to_thread(stream.read, _BLOCK):
                    yield block
        finally:
            self.close()

    def close(self) -> None:
        """Remove the file and its folder."""
        self._folder.cleanup()


async def clean_file(job: CleaningJob, ending: str) -> TemporaryOutput:
    """Clean a file as `becalm clean` does.

    Parameters
    ----------
    job : CleaningJob
        File and recipe.
    ending : str
        Ending of the output's name, without the dot; it decides the format.

    Raises
    ------
    OutputError
        If there is no such format, or the file cannot be written.
    """
    if f".{ending}" not in ENDINGS:
        raise OutputError(f"There is no format {ending!r} to save in; choose {', '.join(sorted(ENDINGS))}.")
    return await _save(job, f"{stem_of(job.file)}-clean.{ending}", None)


async def write_report(job: CleaningJob) -> TemporaryOutput:
    """Write the report on a file as `becalm clean --report` does.

    Raises
    ------
    OutputError
        If the report cannot be written.
    """
    return await _save(job, f"{stem_of(job.file)}-clean.npz", f"{stem_of(job.file)}-report.html")


async def _save(job: CleaningJob, output: str, page: str | None) -> TemporaryOutput:
    try:
        folder = tempfile.TemporaryDirectory(prefix="becalm-", ignore_cleanup_errors=True)
        return await _save_in(folder, job, output, page)
    except OSError as cause:
        says = f"{page or output} cannot be made ({cause.strerror}); free space for temporary files, or set TMPDIR."
        raise OutputError(says) from cause


async def _save_in(
    folder: tempfile.TemporaryDirectory[str], job: CleaningJob, output: str, page: str | None
) -> TemporaryOutput:
    try:
        inside, file = Path(folder.name).resolve(), job.file.resolve()
        recipe = inside / "recipe.toml"
        await asyncio.to_thread(recipe.write_text, job.recipe, encoding="utf-8")
        words = ["clean", str(file), "-o", str(inside / output), "--recipe", str(recipe)]
        words += ["--report", str(inside / page)] if page is not None else []
        words += ["--group", job.group] if job.group is not None else []
        try:
            await _run(words, inside)
        except OutputError as cause:  # replace paths by names, which is what a page shows
            named = str(cause).replace(str(file), job.file.name).replace(f"{inside}{os.sep}", "")
            raise OutputError(named.replace(str(inside), "the folder for temporary files")) from cause
        name = output if page is None else page
        return TemporaryOutput(folder, inside / name, name)
    except BaseException:
        folder.cleanup()
        raise


async def _run(words: list[str], inside: Path) -> None:
    """Run becalm in a private folder; kill the process if the task is cancelled.

    Raises
    ------
    OutputError
        If becalm fails; the message is its error output.
    """
    process = await asyncio.create_subprocess_exec(
        *MODULE,
        "becalm",
        *words,
        cwd=inside,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
        env={**environment(), "COLUMNS": "10000", "NO_COLOR": "1"},
    )
    try:
        _, errors = await process.communicate()
    except BaseException:
        if process.returncode is None:
            process.kill()
            await process.wait()
        raise
    if process.returncode not in (0, NOT_DESCRIBED):
        text = errors.decode("utf-8", "replace").strip()
        raise OutputError(text or f"It could not be saved: becalm ended with {process.returncode}.")
