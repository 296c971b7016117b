"""The courses and run folders that reports are tested on."""

from tests.course_fixtures import *  # noqa: F403
