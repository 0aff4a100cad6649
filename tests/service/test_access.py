"""Keys, ownership, share links, rates, and what browsers may be tricked into."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from redis import Redis
from starlette.testclient import TestClient

from service.access.cli import keys as keys_command
from service.access.store import KeyStore, RateLimit
from service.app import create_app
from service.settings import Settings
from tests.services import form, running_worker, wait_for


@pytest.fixture
def strict(settings: Settings) -> Settings:
    return settings.model_copy(update={"require_keys": True, "content_check_bytes": 0})


@pytest.fixture
def client(strict: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(strict), base_url="http://service.example") as made:
        yield made


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def test_jobs_belong_to_their_key(client: TestClient, redis: Redis) -> None:
    store = KeyStore(redis)
    (anna, anna_token), (_, ben_token) = store.create("anna"), store.create("ben")
    assert anna_token.split("_", 2)[2] not in str(redis.hgetall(f"mpf:key:{anna.id}"))
    refused = client.post("/jobs", **form())
    assert (refused.status_code, refused.json()["code"]) == (401, "access.denied")
    assert refused.headers["www-authenticate"] == "Bearer"
    for wrong in ("x", anna_token + "x", anna_token.replace(anna.id, "0" * 12), "mpf__"):
        assert client.get("/jobs", headers=bearer(wrong)).status_code == 401
    job_id = client.post("/jobs", headers=bearer(anna_token), **form()).json()["id"]
    assert client.get(f"/jobs/{job_id}", headers=bearer(anna_token)).status_code == 200
    for method, path in [
        ("GET", ""), ("GET", "/mesh.glb"), ("GET", "/events"), ("POST", "/cancel"),
        ("POST", "/retry"), ("POST", "/extractions"), ("GET", "/field.safetensors"),
        ("DELETE", ""), ("POST", "/shares"),
    ]:  # fmt: skip
        answer = client.request(method, f"/jobs/{job_id}{path}", headers=bearer(ben_token))
        assert (answer.status_code, answer.json()["code"]) == (404, "job.not_found"), path
    assert client.get("/jobs", headers=bearer(ben_token)).json()["jobs"] == []
    assert client.get("/livez").status_code == 200
    store.revoke(anna.id)
    assert client.get(f"/jobs/{job_id}", headers=bearer(anna_token)).status_code == 401


def test_a_share_link_reads_one_job_and_can_be_ended(
    client: TestClient, strict: Settings, redis: Redis
) -> None:
    _, token = KeyStore(redis).create("anna")
    job_id = client.post("/jobs", headers=bearer(token), **form(name="ok.xyz")).json()["id"]
    share = client.post(f"/jobs/{job_id}/shares", headers=bearer(token)).json()
    with running_worker(strict):
        wait_for(lambda: client.get(share["href"]).json()["state"] == "succeeded", 30, "success")
    assert client.get(f"{share['href']}/mesh.glb").content.startswith(b"glTF")
    assert client.get(f"{share['href']}/slices/x/0.png").status_code == 200
    assert client.get(f"{share['href']}/../input.xyz").status_code == 404
    assert client.get(f"{share['href']}/%2e%2e/input.xyz").status_code == 404
    assert client.get("/shared/nonsense").json()["code"] == "share.not_found"
    for method in ("POST", "DELETE"):
        assert client.request(method, share["href"]).status_code == 405  # it only lets read
    brief = client.post(f"/jobs/{job_id}/shares", headers=bearer(token), json={"seconds": 60})
    (left,) = [redis.ttl(key) for key in redis.keys(f"*{brief.json()['id']}*")]
    assert 0 < left <= 60
    ended = client.delete(f"/jobs/{job_id}/shares/{share['id']}", headers=bearer(token))
    assert ended.status_code == 204
    assert client.get(share["href"]).status_code == 404


def test_rates_and_quotas(strict: Settings, redis: Redis) -> None:
    limits = {"requests_per_minute": 60, "requests_burst": 3, "jobs_per_owner": 1}
    with TestClient(create_app(strict.model_copy(update=limits))) as client:
        _, token = KeyStore(redis).create("anna")
        assert client.post("/jobs", headers=bearer(token), **form()).status_code == 202
        full = client.post("/jobs", headers=bearer(token), **form())
        assert (full.status_code, full.json()["code"]) == (429, "quota.jobs")
        assert int(full.headers["retry-after"]) >= 1
        answers = [client.get("/jobs", headers=bearer(token)) for _ in range(3)]
        assert answers[-1].json()["code"] == "rate.exceeded"
        assert int(answers[-1].headers["retry-after"]) >= 1
        _, other = KeyStore(redis).create("ben")
        assert client.get("/jobs", headers=bearer(other)).status_code == 200


def test_a_rate_survives_a_clock_that_went_back(redis: Redis) -> None:
    rate = RateLimit(redis, 60, 2)
    assert rate.seconds_to_wait("a") == 0
    (name,) = redis.keys("mpf:rate:*")
    redis.set(name, int(redis.time()[0] + 86_400) * 1000)
    assert rate.seconds_to_wait("a") == 0


def test_pages_of_other_origins_cannot_use_a_keyless_service(settings: Settings) -> None:
    told = {"cors_origins": ("https://app.example",), "allowed_hosts": ("box.example",)}
    with TestClient(create_app(settings.model_copy(update=told))) as client:
        for host in ("localhost:8000", "127.0.0.1", "[::1]:80", "box.example"):
            assert client.get("/jobs", headers={"Host": host}).status_code == 200
        rebound = client.get("/jobs", headers={"Host": "evil.example"})
        assert (rebound.status_code, rebound.json()["code"]) == (421, "access.host")
        local = {"Host": "localhost:8000"}
        foreign = client.post("/jobs", headers=local | {"Origin": "https://evil.example"}, **form())
        assert (foreign.status_code, foreign.json()["code"]) == (403, "access.origin")
        for origin in ("http://localhost:8000", "https://app.example"):
            answer = client.post("/jobs", headers=local | {"Origin": origin}, **form())
            assert answer.status_code == 202
        assert answer.headers["access-control-allow-origin"] == "https://app.example"
        asked = {"Access-Control-Request-Method": "PATCH", "Origin": "https://app.example"}
        asked["Access-Control-Request-Headers"] = "Tus-Resumable, Idempotency-Key"
        allowed = client.options("/uploads/x", headers=local | asked)
        assert allowed.status_code == 200
        assert "PATCH" in allowed.headers["access-control-allow-methods"]
        refused = client.options(
            "/jobs", headers=local | asked | {"Origin": "https://evil.example"}
        )
        assert "access-control-allow-origin" not in refused.headers
        assert "access-control-allow-origin" not in foreign.headers


def test_keys_are_made_listed_and_revoked_without_a_running_service() -> None:
    with tempfile.TemporaryDirectory(prefix="mpf-") as folder:
        where = ["--data-dir", str(Path(folder) / "data")]
        run = CliRunner()
        made = run.invoke(keys_command, [*where, "create", "anna"])
        assert made.exit_code == 0, made.output
        token = made.stdout.strip()
        key_id = token.split("_")[1]
        assert "valid" in run.invoke(keys_command, [*where, "list"]).output
        assert run.invoke(keys_command, [*where, "revoke", key_id]).exit_code == 0
        listed = run.invoke(keys_command, [*where, "list"]).output
        assert "revoked" in listed
        assert "anna" in listed
        assert run.invoke(keys_command, [*where, "revoke", "nobody"]).exit_code == 1
