"""What the gates share."""

import pytest
from helpers.calls import why_not


@pytest.fixture
def watched(forked):
    """``forked``; its system calls can be seen, see ``calls``."""
    if why_not():
        pytest.skip(why_not())
    return forked
