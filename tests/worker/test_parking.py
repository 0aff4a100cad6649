"""Jobs of one owner run so many at a time; the others wait and are in nobody's way."""

from __future__ import annotations

from collections import Counter

from redis import Redis
from starlette.testclient import TestClient

from service.access.store import KeyStore
from service.app import create_app
from service.jobs.model import JobState
from service.jobs.store import JobStore
from service.settings import Settings
from tests.services import form, running_worker, wait_for


def test_a_key_runs_one_job_at_a_time_while_another_key_passes_by(
    settings: Settings, redis: Redis
) -> None:
    capped = settings.model_copy(
        update={"running_per_owner": 1, "require_keys": True, "content_check_bytes": 0}
    )
    store = JobStore(redis, retention_seconds=100)
    most: Counter[str] = Counter()
    with TestClient(create_app(capped), base_url="http://localhost") as client:
        keys = KeyStore(redis)
        (anna, anna_token), (_, ben_token) = keys.create("anna"), keys.create("ben")

        def submit(token: str, name: str) -> str:
            headers = {"Authorization": f"Bearer {token}"}
            return str(client.post("/jobs", headers=headers, **form(name=name)).json()["id"])

        with running_worker(capped), running_worker(capped):
            first = submit(anna_token, "long-8.xyz")
            wait_for(lambda: store.count(JobState.RUNNING), 20, "the first")
            later = [submit(anna_token, "ok.xyz") for _ in range(3)]
            ben = submit(ben_token, "ok.xyz")

            def ended() -> bool:
                running = store.running()
                for owner, count in Counter(job.owner for job in running).items():
                    most[owner] = max(most[owner], count)
                if any(job.id == first for job in running):
                    assert store.count(JobState.SUCCEEDED) <= 1  # ben's alone
                return store.count(JobState.SUCCEEDED) == 5

            wait_for(ended, 40, "all jobs ended")
    assert most[anna.id] == 1
    jobs = {job_id: store.get(job_id) for job_id in (first, *later, ben)}
    finished = {job_id: job.finished_at for job_id, job in jobs.items() if job}
    assert finished[ben] < finished[first]  # type: ignore[operator]
    assert not store.parked()
    assert store.running_of(anna.id) == 0
    assert all(job and job.attempt == 1 for job in jobs.values())
