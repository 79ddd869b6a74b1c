"""`styl3r tradeoff` with the tiny model, in this process."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from styl3r_cli.tradeoff import bench, worker

Run = Callable[..., tuple[int, bytes, str]]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Workers run in this process instead of their own; the jobs that they got."""
    jobs: list[dict[str, Any]] = []

    def work(job: dict[str, Any]) -> dict[str, Any]:
        jobs.append(job)
        return json.loads(json.dumps(worker.measure(json.loads(json.dumps(job)))))

    monkeypatch.setattr(bench, "work", work)
    return jobs


@pytest.fixture
def measure(run: Run) -> Run:
    """`tradeoff` with the tiny model; `--threads` are the fixture's own."""
    return lambda *given: run("tradeoff", *given)
