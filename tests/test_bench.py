"""The bench from end to end: the code that `make bench` runs, at a size for the tests."""

import json

import yaml
from helpers import ROOT, ran_small

STUDIES, BENCH = ROOT / "tests/studies", ROOT / "tests/bench"


def test_the_bench_runs(tmp_path):
    said = ran_small(BENCH / "bench.py", tmp_path).stdout
    summary = json.loads((tmp_path / "outputs/bench/summary.json").read_text())
    small = yaml.safe_load((STUDIES / "small.yaml").read_text())["bench"]
    rows = {f"{key}_over_floor" for key in ("error_model", "means", "peer_allantools")}
    rows |= {f"{key}_over_floor" for key in small["end_to_end"]}
    rows |= {"end_to_end_vehicle_over_rollout", "two_process_speedup", "data_wait_percent"}
    rows |= {"open_100gb_s", "vehicle_over_pinned_limit", "two_process_speedup_over_pinned_limit"}
    assert rows <= set(summary), said
    assert all(summary[row] >= 0 for row in rows)
    assert (tmp_path / "outputs/bench/table.csv").exists()
