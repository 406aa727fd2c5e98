"""Many threads open, read and run studies at the same time: no crash, and the same bits."""

import pytest
from helpers.processes import start_python, wait_for_end

pytestmark = [pytest.mark.full, pytest.mark.kernel, pytest.mark.timeout(180)]


@pytest.mark.parametrize("program", ["run", "threads in a loop", "loky in a loop"])
def test_a_program_with_many_threads_ends_well(tmp_path, program):
    words = ("-X", "faulthandler", "-m", "helpers.many_threads", program, tmp_path)
    code, _, stderr = wait_for_end(start_python(*words, cwd=tmp_path), seconds=150)
    assert code == 0, stderr[-3000:]
