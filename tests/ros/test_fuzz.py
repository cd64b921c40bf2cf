"""Messages that nobody vouches for, through the callbacks of the real node: mutated ones, and some with a purpose."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from message_mutations import HOSTILE_NAMES, mutated_body, mutated_pattern, real_bodies, real_patterns
from small_scenes import BOX_TRIANGLES, BOX_VERTICES, handkerchief

from cloth_core.body import Body
from cloth_core.errors import BodyError, PatternError
from cloth_core.pattern import MAX_TEXT_BYTES, Pattern
from cloth_sim_ros.cdr import CdrError
from cloth_sim_ros.messages import decode_mesh, decode_string, encode_mesh, encode_string

SCRIPT = Path(__file__).with_name("fuzz_messages.py")


def test_mutated_messages_do_not_harm_the_node():
    """The first of those that `python tests/ros/fuzz_messages.py --count 10000` sends."""
    command = [sys.executable, "-X", "faulthandler", str(SCRIPT), "--count", "30", "--seed", "100000"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=SCRIPT.parent)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Warning" not in done.stderr
    taken, refused = map(int, re.search(r"(\d+) taken, (\d+) refused for", done.stdout).groups())
    assert taken > 5
    assert refused > 10


def test_mutations_are_the_same_on_every_machine_and_reach_all_checks():
    patterns, bodies = real_patterns(), real_bodies()
    reasons = set()
    for seed in range(60):
        for mutate, sources, read in (
            (mutated_pattern, patterns, lambda data: Pattern.from_json(decode_string(data))),
            (mutated_body, bodies, lambda data: Body.from_arrays(*decode_mesh(data, 100_000))),
        ):
            data = mutate(seed, sources)
            if seed < 10:
                assert data == mutate(seed, sources)
            try:
                read(data)
            except (BodyError, PatternError, CdrError) as error:
                line = str(error)
                assert line.isprintable()
                reasons.add(re.sub(r"'[^']*'|[\d.e+-]+", "#", line)[:60])
    assert len(reasons) > 25


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_name_is_a_name(name):
    """As the name of a panel: refused in one short line, or taken as text."""
    text = handkerchief().replace('"cloth"', json.dumps(name))
    if name and name.isprintable() and len(name) <= 200:
        assert list(Pattern.from_json(text).panels) == [name]
        return
    with pytest.raises(PatternError) as caught:
        Pattern.from_json(text)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("opening", ["[", '{"a":', '{"pattern":{"panels":', "[{"])
@pytest.mark.parametrize("depth", [1_000, 100_000])
def test_deep_nesting_is_refused(opening, depth):
    with pytest.raises(PatternError, match=r"nested too deep|not JSON"):
        Pattern.from_json(opening * depth)


def test_more_text_than_a_pattern_can_have_is_refused_unread():
    with pytest.raises(PatternError, match=f"at most {MAX_TEXT_BYTES}"):
        Pattern.from_json("[" * (MAX_TEXT_BYTES + 1))


@pytest.mark.parametrize("count", [0, 1, 2**31, 2**32 - 1])
def test_a_forged_count_takes_no_memory(count):
    import tracemalloc

    data = bytearray(encode_mesh(BOX_VERTICES, BOX_TRIANGLES))
    at = 8 + 12 * len(BOX_TRIANGLES)
    tracemalloc.start()
    for place in (4, at):
        forged = data.copy()
        forged[place : place + 4] = count.to_bytes(4, "little")
        with pytest.raises(BodyError):
            decode_mesh(bytes(forged), 500_000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100_000


def test_unused_vertices_count_too():
    vertices = np.concatenate([BOX_VERTICES, np.zeros((3 * 12 - 8 + 1, 3))])
    decode_mesh(encode_mesh(vertices[:-1], BOX_TRIANGLES), 12)
    with pytest.raises(BodyError, match="37 vertices are more than max_triangles = 12 can have"):
        decode_mesh(encode_mesh(vertices, BOX_TRIANGLES), 12)


@pytest.mark.parametrize("scale", [2e7, 1e155, 1e300])
@pytest.mark.filterwarnings("error")
def test_an_absurd_body_is_refused_before_it_is_reckoned_with(scale):
    with pytest.raises(BodyError, match=r"vertex \d: .* lies more than 1e\+06 m from the origin; give metres"):
        Body.from_arrays(scale * BOX_VERTICES, BOX_TRIANGLES)


def test_an_outline_of_thousands_of_curves_is_checked_with_few_samples_each(monkeypatch):
    from cloth_core import curves

    taken = []
    point = curves.QuadraticBezier.point
    monkeypatch.setattr(curves.QuadraticBezier, "point", lambda self, t: taken.append(len(t)) or point(self, t))
    count = 4000
    angles = 2 * np.pi * np.arange(count) / count
    root = json.loads(handkerchief())
    root["pattern"]["panels"]["cloth"] |= {
        "vertices": (0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist(),
        "edges": [
            {"endpoints": [i, (i + 1) % count], "curvature": {"type": "quadratic", "params": [[0.5, 0.01]]}}
            for i in range(count)
        ],
    }
    Pattern.from_json(json.dumps(root))
    assert sum(taken) <= 2 * 50_000


def test_a_text_that_is_not_utf8_is_refused():
    with pytest.raises(CdrError, match="not UTF-8 at byte 1"):
        decode_string(encode_string("ab").replace(b"ab", b"a\xff"))
