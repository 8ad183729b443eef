"""Whatever fails while files are written: all are old, or all are new, or the error says which."""

from __future__ import annotations

import errno
import os
import re
import signal
import socket
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.files import keeping_inputs
from factorgraph_adj.io.file_transaction import one_transaction, write_files
from factorgraph_adj.io.transaction_folders import WRITING_PREFIX, UnfinishedError, recover_folder
from tests.networks.epochs import epoch
from tests.support.failing import failing

ALL = {"x.txt": "new", "gone.txt": None, "more.txt": "new"}
"""New contents: of a file that is replaced, one that is removed, and one that was not there."""
THREE = {"a": ALL, "b": ALL, "c": ALL}
TWO = {"a": {"x.txt": "new", "gone.txt": None}, "b": {"x.txt": "new", "more.txt": "new"}}
DISK_FULL = partial(OSError, errno.ENOSPC, os.strerror(errno.ENOSPC))
ERRORS = pytest.mark.parametrize("error", [DISK_FULL, KeyboardInterrupt], ids=["disk", "^C"])


@pytest.fixture
def place(tmp_path):
    """Return an empty folder, in memory where the system has that: renames wait for disks."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


def old(files):
    return {name: "old" for name in files if name != "more.txt"}


def new(files):
    return {name: text for name, text in files.items() if text is not None}


def tree(place, changes):
    """Return the changes by folder; each has old files and no others."""
    folders = {place / name: files for name, files in changes.items()}
    for folder, files in folders.items():
        folder.mkdir(exist_ok=True)
        for path in folder.iterdir():
            path.unlink()
        for name, text in old(files).items():
            (folder / name).write_text(text)
    return folders


def change(folders, error=None, fails=lambda number: False):
    """Write to all folders while calls fail: the error, the calls, and what is noted as written."""
    raised = None
    with keeping_inputs() as run, failing(error, fails) as calls:
        try:
            with one_transaction():
                for folder, files in folders.items():
                    write_files(folder, files)
        except (InputError, KeyboardInterrupt) as found:
            raised = found
    return raised, calls, run.written


@contextmanager
def full_after(moves):
    """Let all moves fail after some."""
    place, done = os.replace, []

    def full(source, target):
        if len(done) == moves:
            raise DISK_FULL()
        done.append(target)
        place(source, target)

    with patch("os.replace", full):
        yield


def stopped(folders, moves=1):
    """Write to all folders; after some moves, all others and putting back fail for good."""
    with full_after(moves), pytest.raises(UnfinishedError) as raised, one_transaction():
        for folder, files in folders.items():
            write_files(folder, files)
    return raised.value


def texts(folder):
    return {p.name: p.read_text() for p in folder.glob("*.txt")}


def all_are(folders, state):
    return all(texts(folder) == state(files) for folder, files in folders.items())


def left(folders):
    return [p for f in folders for p in f.glob(f"{WRITING_PREFIX}*")]


def check_named(folders, error):
    """Assert that an error says of every file what it is, and where the old copy is."""
    said = {}
    for problem in error.problems:
        for names, state in re.findall(r"([\w., ]+\.txt): ([^;]+)", problem.what):
            said |= {Path(problem.where, name): state for name in names.strip().split(", ")}
    assert set(said) == {folder / name for folder, files in folders.items() for name in files}
    for path, state in said.items():
        files = folders[path.parent]
        there = path.read_text() if path.exists() else None
        if state == "as before":
            assert there == old(files).get(path.name), path
            continue
        assert there == files[path.name], path
        assert state.startswith("removed" if there is None else "new"), path
        if path.name in old(files):
            copies = Path(state.partition("whose old copies are in ")[2])
            assert copies.is_absolute()
            assert (copies / path.name).read_text() == "old"


def check_outcome(folders, raised, written):
    """Assert that all files are old, or new, or named; and all the same after recovery."""
    if isinstance(raised, UnfinishedError):
        assert not written
        check_named(folders, raised)
    else:
        assert all_are(folders, new if written else old)
        assert written or raised is not None
    for folder in folders:
        recover_folder(folder)
    assert all_are(folders, new if written else old)
    assert not left(folders)


@ERRORS
def test_one_failure_at_any_step_leaves_all_old_or_all_new_files(place, error):
    folders = tree(place, THREE)
    for step in count(1):
        raised, calls, written = change(folders, error, lambda n, step=step: n == step)
        assert not isinstance(raised, UnfinishedError), step
        check_outcome(folders, raised, written)
        if not calls.failed:
            break
        tree(place, THREE)
    assert step > 60
    assert raised is None


LONG = pytest.mark.slow("every pair of two steps; the short tests have the pairs that are named")


@ERRORS
@pytest.mark.parametrize("begin", [1, 2], ids=["odd", "even"])
@pytest.mark.parametrize(
    "lasting", [pytest.param(False, marks=LONG), True], ids=["once more", "from then on"]
)
def test_a_second_failure_at_any_step_is_overcome_or_the_error_names_every_file(
    place, error, begin, lasting
):
    """What the error names is put back by the next one, when calls do not fail any more.

    The first failures are those of odd or of even number.
    """
    folders = tree(place, TWO)
    named = 0
    for first in count(begin, 2):
        for second in count(first + 1):

            def fails(n, first=first, second=second):
                return n == first or (n >= second if lasting else n == second)

            raised, calls, written = change(folders, error, fails)
            check_outcome(folders, raised, written)
            named += isinstance(raised, UnfinishedError)
            tree(place, TWO)
            if calls.failed < 2:
                break
        if not calls.failed:
            break
    assert first > 40
    assert (named > 0) == lasting


@pytest.mark.parametrize("lasting", [False, True], ids=["once", "from then on"])
def test_recovery_that_fails_at_any_step_says_so_and_the_next_one_goes_on(place, lasting):
    folders = tree(place, TWO)
    refused = 0
    for step in count(1):
        check_named(folders, stopped(folders))

        def fails(n, step=step):
            return n >= step if lasting else n == step

        said = None
        with failing(DISK_FULL, fails) as calls:
            try:
                recover_folder(place / "ab"[step % 2])
            except UnfinishedError as error:
                said = error
        if said is not None:
            refused += 1
            if "it lists files" not in str(said):
                check_named(folders, said)
        for folder in folders:
            recover_folder(folder)
        assert all_are(folders, old), step
        assert not left(folders), step
        if not calls.failed:
            break
    assert refused > (10 if lasting else 0)


def test_a_file_that_somebody_changed_after_writing_had_stopped_is_not_replaced(place):
    folders = tree(place, TWO)
    stopped(folders)
    changed = place / "a" / "x.txt"
    changed.write_text("mine")
    for _ in range(2):
        with pytest.raises(UnfinishedError, match="changed by somebody else") as raised:
            write_files(place / "a", {"next.txt": "next"})
    assert changed.read_text() == "mine"
    (copies,) = place.glob(f"a/{WRITING_PREFIX}*/.old")
    assert str(copies) in str(raised.value)
    assert (copies / "x.txt").read_text() == "old"
    changed.unlink()  # whoever wants the old files back removes the other one
    recover_folder(place / "b")
    assert all_are(folders, old)
    assert not left(folders)


def test_a_new_file_that_somebody_replaced_by_another_one_stays(place):
    folders = tree(place, {"a": {"more.txt": "new", "x.txt": "new", "y.txt": "new"}})
    stopped(folders, moves=2)
    (place / "a" / "more.txt").write_text("mine")
    recover_folder(place / "a")
    assert texts(place / "a") == {"x.txt": "old", "y.txt": "old", "more.txt": "mine"}
    assert not left(folders)


def test_a_folder_that_was_renamed_after_writing_had_stopped_recovers(place):
    stopped(tree(place, {"a": ALL}))
    (place / "a").rename(place / "elsewhere")
    recover_folder(place / "elsewhere")
    assert texts(place / "elsewhere") == old(ALL)


def test_a_folder_whose_transaction_has_gone_is_named(place):
    folders = tree(place, TWO)
    stopped(folders, moves=2)
    (place / "a").rename(place / "elsewhere")
    with pytest.raises(UnfinishedError, match="which have gone"):
        recover_folder(place / "b")
    recover_folder(place / "elsewhere")
    assert texts(place / "elsewhere") == old(TWO["a"])


@pytest.mark.parametrize("other", ["other-host", f"{socket.gethostname()}-{2**22 + 1}"])
@pytest.mark.parametrize("folder", ["a", "b"])
def test_what_another_computer_has_begun_is_named_and_left(place, folder, other):
    folders = tree(place, TWO)
    with patch("socket.gethostname", lambda: other):
        stopped(folders, moves=2)
    process = f"process {os.getpid()} of the computer '{other}'"
    with pytest.raises(UnfinishedError, match=process):
        write_files(place / folder, {"next.txt": "next"})
    with patch("socket.gethostname", lambda: other):
        recover_folder(place / folder)
    assert all_are(folders, old)
    write_files(place / folder, {"next.txt": "next"})


def test_reading_a_project_puts_back_what_writing_it_has_left_half_way(place, capsys):
    path = place / "project.toml"
    fga.write_project(epoch(1, datum="given"), path)
    before = {p.name: p.read_bytes() for p in place.iterdir()}
    with pytest.raises(UnfinishedError), full_after(moves=1):
        fga.write_project(epoch(2, datum="given"), path)
    with full_after(moves=0):
        assert main(["check", str(place)]) == 2
    said = capsys.readouterr().err
    (copies,) = place.glob(f"{WRITING_PREFIX}*/.old")
    assert f"{place}: points.csv: new, whose old copies are in {copies}; " in said
    assert "observations.csv, project.toml: as before" in said
    for read in (fga.read_project, fga.read):
        read(path)
        assert {p.name: p.read_bytes() for p in place.iterdir()} == before


def test_a_folder_in_the_place_of_a_file_changes_nothing(place):
    folders = tree(place, TWO)
    (place / "b" / "more.txt").mkdir()
    refused = pytest.raises(InputError, match=r"more\.txt: cannot be written: is a folder")
    with refused, one_transaction():
        for folder, files in folders.items():
            write_files(folder, files)
    (place / "b" / "more.txt").rmdir()
    assert all_are(folders, old)
    assert not left(folders)


@ERRORS
def test_without_links_old_files_are_copied(place, error):
    """Some file systems have no links, and files of others must not be linked."""
    folders = tree(place, TWO)

    def refused(*_, **__):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    replace = os.replace

    def full(source, target):
        if Path(target).name == "more.txt":
            raise error()
        replace(source, target)

    with patch("os.link", refused):
        with patch("os.replace", full):
            assert isinstance(change(folders)[0], InputError | KeyboardInterrupt)
        assert all_are(folders, old)
        change(folders)
    assert all_are(folders, new)
    assert not left(folders)


def test_a_symbolic_link_that_is_replaced_comes_back_as_a_link(place):
    folders = tree(place, TWO)
    link = place / "a" / "x.txt"
    link.unlink()
    link.symlink_to("nowhere.txt")
    stopped(folders)
    assert not link.is_symlink()
    recover_folder(place / "a")
    assert os.readlink(link) == "nowhere.txt"


def signalled(number):
    """Return a function that replaces files, and sends a signal at the first one."""
    place, done = os.replace, []

    def replace(source, target):
        if not done:
            signal.raise_signal(number)
        done.append(target)
        place(source, target)

    return replace


def test_ctrl_c_in_the_middle_of_the_moves_waits_for_them(place):
    folders = tree(place, TWO)
    with patch("os.replace", signalled(signal.SIGINT)):
        raised, _, written = change(folders)
    assert isinstance(raised, KeyboardInterrupt)
    assert len(written) == 4
    check_outcome(folders, raised, written)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the signal ends the process in a fork")
def test_a_signal_to_end_in_the_middle_of_the_moves_waits_for_them(place):
    folders = tree(place, TWO)
    process = os.fork()
    if not process:
        try:
            os.replace = signalled(signal.SIGTERM)
            change(folders)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == -signal.SIGTERM
    assert all_are(folders, new)
    assert not left(folders)


def test_a_command_that_is_interrupted_says_what_it_has_written(place, capsys):
    fga.write_project(epoch(1, datum="given"), place / "project.toml")
    command = ["convert", str(place), str(place / "new" / "project.toml")]
    with patch("os.replace", signalled(signal.SIGINT)):
        assert main(command) == 130
    written = len(list((place / "new").iterdir()))
    assert f"interrupted: {written} files are written already, in {place / 'new'}" in (
        capsys.readouterr().err
    )


def test_two_outputs_that_are_one_file_are_refused(place):
    refused = pytest.raises(InputError, match="is named for two outputs of this run")
    with refused, one_transaction():
        write_files(place, {"x.txt": "one"})
        write_files(place / ".." / place.name, {"x.txt": "other"})
    assert texts(place) == {}
