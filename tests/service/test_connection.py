"""Redis over TLS, as an ACL user, and through Sentinels that fail over: real servers."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import ipaddress
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from redis import Redis
from redis.exceptions import RedisError
from starlette.testclient import TestClient

from service.app import create_app
from service.connection import UnsafeRedis, Watched, connect
from service.embedded import find_binary
from service.settings import Settings
from tests.services import form, running_worker, wait_for

# As docs/operations.md has them.
ACL_RULES = ("~mpf:*", "~rq:*", "&*", "+@all", "-@dangerous", "+info", "+keys")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def valkey(folder: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A server of its own."""
    folder.mkdir(exist_ok=True)
    command = [str(find_binary()), *options, "--dir", str(folder), "--save", ""]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def answers(url: str) -> bool:
    redis = Redis.from_url(url, socket_timeout=1.0)
    try:
        return bool(redis.ping())
    except (RedisError, OSError):
        return False
    finally:
        redis.close()


def certificate(folder: Path) -> tuple[Path, Path]:
    """A self-signed one for 127.0.0.1, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "mpf test")])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]),
            critical=False,
        )
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    cert, secret = folder / "cert.pem", folder / "key.pem"
    pem = serialization.Encoding.PEM
    cert.write_bytes(made.public_bytes(pem))
    secret.write_bytes(
        key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return cert, secret


@contextlib.contextmanager
def tls_in_front_of(port: int, cert: Path, key: Path) -> Iterator[int]:
    """A port that speaks TLS, as a managed Redis has it: the server of the tests is built without.

    Yields the port.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(cert, key)
    loop = asyncio.new_event_loop()

    async def pump(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await source.read(65_536):
                target.write(data)
                await target.drain()
        target.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner, outer = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(pump(reader, outer), pump(inner, writer))

    server = loop.run_until_complete(asyncio.start_server(serve, "127.0.0.1", 0, ssl=context))
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    yield int(server.sockets[0].getsockname()[1])
    loop.call_soon_threadsafe(loop.stop)
    thread.join()


def test_a_job_over_tls_as_an_acl_user(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    plain = free_port()
    with (
        valkey(tmp_path / "valkey", "--port", str(plain), "--bind", "127.0.0.1"),
        tls_in_front_of(plain, cert, key) as port,
    ):
        wait_for(lambda: answers(f"redis://127.0.0.1:{plain}"), 10, "Valkey")
        admin = Redis(port=plain)
        admin.execute_command("ACL", "SETUSER", "mpf", "on", ">p@ss", *ACL_RULES)
        admin.execute_command("ACL", "SETUSER", "default", "off")
        admin.close()
        assert not answers(f"redis://127.0.0.1:{plain}"), "nobody without a name"
        url = f"rediss://mpf:p%40ss@127.0.0.1:{port}/0?ssl_ca_certs={cert}"
        assert answers(url)
        assert not answers(f"rediss://mpf:p%40ss@127.0.0.1:{port}/0"), "nobody vouches for it"
        a_job_ends(Settings(redis_url=url, data_dir=tmp_path / "data", content_check_bytes=0))


@pytest.mark.slow
def test_sentinels_lead_to_the_primary_that_is(tmp_path: Path) -> None:
    first, second, guard = free_port(), free_port(), free_port()
    secret = ["--requirepass", "s3cret", "--masterauth", "s3cret"]
    with (
        valkey(tmp_path / "a", "--port", str(first), *secret) as primary,
        valkey(tmp_path / "b", "--port", str(second), *secret, "--replicaof", f"127.0.0.1 {first}"),
        sentinel(tmp_path / "c", guard, first),
    ):
        url = f"redis+sentinel://:s3cret@127.0.0.1:{guard}/jobs"
        settings = Settings(redis_url=url, data_dir=tmp_path / "data", content_check_bytes=0)
        wait_for(lambda: reaches(settings), 10, "the primary")
        replica = Redis(port=second, password="s3cret")  # noqa: S106
        wait_for(lambda: replica.info()["master_link_status"] == "up", 20, "the replica follows")
        replica.close()
        a_job_ends(settings)
        guards = Redis(port=guard)
        wait_for(lambda: guards.sentinel_slaves("jobs"), 30, "the Sentinel knows the replica")
        guards.close()
        with running_worker(settings):
            primary.kill()
            wait_for(lambda: reaches(settings), 40, "the other has become primary")
            a_job_ends(settings, own_worker=False)


def a_job_ends(settings: Settings, *, own_worker: bool = True) -> None:
    """Submitted, followed and succeeded."""
    worker = running_worker(settings) if own_worker else contextlib.nullcontext()
    with TestClient(create_app(settings), base_url="http://localhost") as client, worker:
        answer = client.post("/jobs", **form(name="ok.xyz"))
        assert answer.status_code == 202, answer.text
        job_id = answer.json()["id"]
        waited = client.get(f"/jobs/{job_id}", params={"wait": 5}).json()
        assert waited["state"] in ("queued", "running", "succeeded")
        look = lambda: client.get(f"/jobs/{job_id}").json()["state"] == "succeeded"  # noqa: E731
        wait_for(look, 20, "success")


def reaches(settings: Settings) -> bool:
    redis = connect(settings)
    try:
        return bool(redis.set("mpf:test", "1"))
    except RedisError:
        return False
    finally:
        redis.close()


@contextlib.contextmanager
def sentinel(folder: Path, port: int, primary: int) -> Iterator[None]:
    folder.mkdir()
    configured = folder / "sentinel.conf"
    configured.write_text(
        f"port {port}\nsentinel monitor jobs 127.0.0.1 {primary} 1\n"
        "sentinel auth-pass jobs s3cret\nsentinel down-after-milliseconds jobs 1000\n"
        "sentinel failover-timeout jobs 3000\n"
    )
    command = [str(find_binary()), str(configured), "--sentinel"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def test_a_url_of_sentinels_is_read_or_refused() -> None:
    place = Watched.at(
        "rediss+sentinel://u:p%40@a:1,b,[::1]:3/name/2?sentinel_password=q&ssl_ca_certs=/x"
    )
    assert place.hosts == [("a", 1), ("b", 26379), ("::1", 3)]
    assert (place.name, place.db) == ("name", 2)
    assert place.options == {
        "ssl": True, "ssl_ca_certs": "/x", "username": "u", "password": "p@",
    }  # fmt: skip
    assert place.for_sentinels == {"ssl": True, "ssl_ca_certs": "/x", "password": "q"}
    for url in ("redis+sentinel://host", "redis+sentinel:///name", "redis+sentinel://h/n/x"):
        with pytest.raises(UnsafeRedis, match="names no primary"):
            connect(Settings(redis_url=url))


def test_the_url_in_logs_has_no_password() -> None:
    url = "redis+sentinel://user:secret@a:1,b:2/name?sentinel_password=secret"
    assert Settings(redis_url=url).redis_safe_url() == "redis+sentinel://a:1,b:2/name"
