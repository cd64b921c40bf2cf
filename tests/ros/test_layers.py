"""Several garments in one pattern message of the node."""

import json

import numpy as np
from small_scenes import handkerchief
from test_worker import Bench

from cloth_sim_ros.log_reader import LogReader
from cloth_sim_ros.messages import decode_marker, decode_string
from cloth_sim_ros.topics import GARMENT, PATTERN


def test_list_of_patterns_is_worn_over_each_other(tmp_path):
    bench = Bench(tmp_path)
    try:
        text = json.dumps([{**json.loads(handkerchief(size)), "name": name} for size, name in ((0.3, "a"), (0.2, "b"))])
        bench.give(text)
        assert bench.worker.describe()["scene"]["panels"] == ["a/cloth", "b/cloth"]
        assert [decode_string(data) for data in bench.listener.of(PATTERN)] == [text]
        heights = np.unique(decode_marker(bench.listener.of(GARMENT)[-1]).points.reshape(-1, 3)[:, 2].round(6))
        np.testing.assert_allclose(heights, [0.15, 0.16])  # they were given in one place
        bench.worker.record(True)
        bench.worker.record(False)
        [log] = (tmp_path / "records").glob("*.mcap")
        with LogReader(log) as reader:
            assert reader.patterns() == [text]
    finally:
        bench.worker.close()
