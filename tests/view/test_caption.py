"""Words on pictures."""

import numpy as np

from kickbench.view.caption import describe_start, font


def test_a_start_is_described_as_in_the_task_file():
    words = describe_start(np.array([0.42, -0.1]), np.array([3.0, -3.0]))
    assert words == "ball (0.42, -0.10) m, target 4.24 m at -45°"


def test_the_font_has_every_character_of_the_words():
    words = describe_start(np.array([0.42, -0.1]), np.array([-3.0, 3.0]))
    missing = bytes(font(20).getmask("\uffff"))
    assert [c for c in set(words) - {" "} if bytes(font(20).getmask(c)) == missing] == []
