"""What the folder of a study must hold, and what is wrong with what it holds."""

from collections.abc import Iterator

from fastcoil.base.errors import FastcoilError, IntegrityError, StorageError
from fastcoil.base.figures import stale_figures
from fastcoil.loops.scenarios import check_same_form
from fastcoil.study.folder import stored
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.results import is_current
from fastcoil.study.folder.stored import Manifest, Shards


def find_problems(store: StudyFolder) -> list[str]:
    """Check every file in a folder: a sentence for each problem.  Nothing is changed.

    Raises
    ------
    InputError
        If the folder holds no study.
    StorageError
        If the results cannot be read.
    IntegrityError
        If ``run.json`` is lost or damaged, so that it is unknown which study the folder holds.
    """
    manifest = store.require_manifest()
    problems: list[str] = []
    try:
        store.read_study(manifest)
    except IntegrityError as error:
        problems = str(error).splitlines()
    problems += problems_of_results(store, manifest)
    return [*problems, *_problems_of_shards(Shards(store.path, manifest.key))]


def problems_of_results(store: StudyFolder, manifest: Manifest) -> Iterator[str]:
    """What is wrong with the final files of a folder, whether or not its study can still be read."""
    if not store.has_results:
        if manifest.finished:
            yield f"{store.results} is missing: run the study again"
        return
    try:
        ds = store.open_results()
        yield from stored.find_problems(ds, store.path, manifest)
    except StorageError:
        raise
    except FastcoilError as error:
        yield str(error)
        return
    if not manifest.finished:
        return
    again = f"run the study again, with -o {store.path}, which puts it right"
    if not is_current(ds, manifest):
        yield f"{store.results} is of another study, or incomplete: {again}"
    elif (store.read_text() or "").replace("\r\n", "\n") != ds.attrs.get("study_toml"):
        yield f"{store.study} is not the text of the study that was run: {again}"
    for path in store.trace_files():
        if path.name != ds.attrs.get("trace_file"):
            yield f"{path} is not of this run: {again}"
    for path in stale_figures(store.path, ds.attrs["content_sha256"]):
        yield f"{path} was drawn from other results: run `fastcoil plot {store.path}`, or delete it"


def _problems_of_shards(shards: Shards) -> Iterator[str]:
    first = None
    for shard in shards.inspect():
        if shard.part is None:
            yield f"{shard.path} {shard.problem}"
            continue
        try:
            first = check_same_form(first, shard.part)
        except FastcoilError as error:
            yield f"{shard.path}: {error}"
