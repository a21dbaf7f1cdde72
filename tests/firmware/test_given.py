"""Nothing here runs before somebody has built a program."""

from __future__ import annotations

import pytest

from tests.firmware.programs import NOT_GIVEN, dictionary, given


def test_programs_are_given():
    if not given():
        pytest.skip(NOT_GIVEN)
    assert all(dictionary(program).commands for program in given())
