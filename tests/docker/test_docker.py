"""The image's recipe, the compose file and the Kubernetes manifests, as far as they can be tried
without Docker and without a cluster. docker/measure.py executes the recipe's steps."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from cloudcoil.models.keda import v1alpha1 as keda

from mpf_core.fit.trainer import KEEP_EVERY
from service.jobs.queue import rq_name
from service.settings import QUEUES, Settings
from tests.services import REPOSITORY, running_worker, wait_for

DOCKER = REPOSITORY / "docker"
MANIFESTS = DOCKER / "kubernetes"
OVERLAYS = sorted(path.parent for path in MANIFESTS.glob("overlays/*/kustomization.yaml"))
KNOWN = {f"MPF_{name.upper()}" for name in Settings.model_fields}
# Of the release that kubernetes-validate knows best; manifests use nothing newer.
RELEASE = "1.31"


def test_the_recipe_is_clean_to_hadolint() -> None:
    found = subprocess.run(
        [str(Path(sys.executable).parent / "hadolint"), str(DOCKER / "Dockerfile")],
        capture_output=True, text=True,
    )  # fmt: skip
    assert found.returncode == 0, found.stdout


def test_the_recipe_s_steps_can_be_executed_elsewhere() -> None:
    steps = runpy.run_path(str(DOCKER / "measure.py"))["steps"]()
    assert list(steps) == ["wheel", "api-packages", "worker-packages", "runtime"]
    for name, command in steps.items():
        checked = subprocess.run(["sh", "-nc", command], capture_output=True, text=True)
        assert checked.returncode == 0, (name, checked.stderr)


def test_what_builds_the_wheel_reaches_the_recipe() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    hook = project["tool"]["hatch"]["build"]["hooks"]["custom"]["path"]
    assert f"!{hook}" in (REPOSITORY / ".dockerignore").read_text().splitlines()
    assert f'"{hook}"' in (DOCKER / "measure.py").read_text()


def test_settings_in_recipe_and_compose_file_are_known() -> None:
    for path in (DOCKER / "Dockerfile", DOCKER / "compose.yaml"):
        told = re.findall(r"^\s*(?:ENV )?(MPF_[A-Z_]+)[=:]", path.read_text(), re.MULTILINE)
        assert told, path
        assert set(told) <= KNOWN


def test_every_variable_of_the_compose_file_is_explained() -> None:
    text = (DOCKER / "compose.yaml").read_text()
    used = set(re.findall(r"(?<!\$)\$\{([A-Z_]+)", text)) - {"MPF_VERSION", "MPF_WORKERS"}
    example = (DOCKER / ".env.example").read_text()
    assert {name for name in used if not re.search(rf"^#?{name}=", example, re.MULTILINE)} == set()


def test_containers_have_no_more_rights_than_they_need() -> None:
    composed = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    assert set(composed["services"]) == {"api", "worker", "valkey", "store"}
    for name, service in composed["services"].items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
    recipe = (DOCKER / "Dockerfile").read_text()
    assert "USER 10001:10001" in recipe
    for target in ("api", "worker"):
        assert f"FROM runtime AS {target}\n" in recipe
    assert recipe.count("HEALTHCHECK") == 2
    for container in (c for doc in all_documents() for c in containers(doc)):
        rights = container["securityContext"]
        assert rights["readOnlyRootFilesystem"] is True
        assert rights["allowPrivilegeEscalation"] is False
        assert rights["capabilities"] == {"drop": ["ALL"]}


@pytest.mark.parametrize("folder", [MANIFESTS / "base", *OVERLAYS], ids=lambda path: path.name)
def test_manifests_are_what_kubernetes_and_keda_take(folder: Path) -> None:
    listed = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
    files = {path.name for path in folder.glob("*.yaml")} - {"kustomization.yaml"}
    assert {name for name in listed if name.endswith(".yaml")} == files
    documents = list(documents_of(folder))
    assert documents
    for document in documents:
        if document["apiVersion"].startswith("keda.sh/"):
            model = getattr(keda, document["kind"])
            read = model.model_validate(document).model_dump(
                mode="json", by_alias=True, exclude_unset=True
            )
            assert read["spec"] == document["spec"], "a field that KEDA does not know"
        else:
            kubernetes_validate.validate(document, RELEASE, strict=True)


def test_a_manifest_with_a_misspelt_field_is_not_taken() -> None:
    (service,) = [d for d in documents_of(MANIFESTS / "base") if d["kind"] == "Service"]
    service["spec"]["prots"] = service["spec"].pop("ports")
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(service, RELEASE, strict=True)


@pytest.mark.parametrize("overlay", OVERLAYS, ids=lambda path: path.name)
def test_an_overlay_serves_every_queue_and_fits_together(overlay: Path) -> None:
    documents = [*documents_of(MANIFESTS / "base"), *documents_of(overlay)]
    names = {(d["kind"], d["metadata"]["name"]) for d in documents}
    assert len(names) == len(documents)
    deployments = {d["metadata"]["name"]: d for d in documents if d["kind"] == "Deployment"}
    served: set[str] = set()
    for name, deployment in deployments.items():
        pod = deployment["spec"]["template"]
        selector = deployment["spec"]["selector"]["matchLabels"]
        assert selector.items() <= pod["metadata"]["labels"].items()
        (container,) = pod["spec"]["containers"]
        if name != "mpf-api":
            served.update(container["args"][-1].split(","))
            # What a worker needs to keep the state of its fit and to hand its job back.
            assert pod["spec"]["terminationGracePeriodSeconds"] > 2 * KEEP_EVERY
            resources = container["resources"]
            assert resources["requests"] == resources["limits"]
        budgets = [d for d in documents if d["kind"] == "PodDisruptionBudget"]
        kept = [b for b in budgets if b["spec"]["selector"]["matchLabels"] == selector]
        assert len(kept) == 1, name
    assert served == set(QUEUES)
    scaled = {
        d["spec"]["scaleTargetRef"]["name"]
        for d in documents
        if d["kind"] in ("HorizontalPodAutoscaler", "ScaledObject")
    }
    assert scaled == set(deployments)
    lists = [
        trigger["metadata"]["listName"]
        for d in documents
        if d["kind"] == "ScaledObject"
        for trigger in d["spec"]["triggers"]
    ]
    assert lists in ([], [f"rq:queue:{rq_name(queue)}" for queue in QUEUES])
    policies = [d for d in documents if d["kind"] == "NetworkPolicy"]
    for deployment in deployments.values():
        labels = deployment["spec"]["template"]["metadata"]["labels"].items()
        assert [p for p in policies if p["spec"]["podSelector"]["matchLabels"].items() <= labels]


@pytest.mark.skipif(shutil.which("kubectl") is None, reason="kubectl is not installed")
@pytest.mark.parametrize("overlay", OVERLAYS, ids=lambda path: path.name)
def test_kustomize_builds_the_overlay(overlay: Path) -> None:
    built = subprocess.run(["kubectl", "kustomize", str(overlay)], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    documents = [d for d in yaml.safe_load_all(built.stdout) if d]
    expected = [*documents_of(MANIFESTS / "base"), *documents_of(overlay)]
    assert len(documents) == len(expected) + 1, "and the generated ConfigMap"
    (config,) = [d for d in documents if d["kind"] == "ConfigMap"]
    assert set(config["data"]) <= KNOWN
    Settings(**{name[4:].lower(): value for name, value in config["data"].items()})


def test_a_worker_s_pulse_is_what_the_health_check_looks_at(
    settings: Settings, tmp_path: Path
) -> None:
    pulse = tmp_path / "worker.alive"
    recipe = (DOCKER / "Dockerfile").read_text()
    (check,) = re.findall(r'CMD \["sh", "-c", "(test .*)"\]', recipe)
    command = ["sh", "-c", check.replace('\\"', '"')]
    healthy = lambda: subprocess.run(command, env={"MPF_PULSE_FILE": str(pulse)}).returncode == 0  # noqa: E731
    assert not healthy()
    alone = settings.model_copy(update={"pulse_file": pulse})
    with running_worker(alone):
        wait_for(healthy, 20, "a pulse")
        before = pulse.stat().st_mtime_ns
        wait_for(lambda: pulse.stat().st_mtime_ns > before, 10, "another one")


def all_documents() -> Iterator[dict[str, Any]]:
    for folder in (MANIFESTS / "base", *OVERLAYS):
        yield from documents_of(folder)


def documents_of(folder: Path) -> Iterator[dict[str, Any]]:
    for path in sorted(folder.glob("*.yaml")):
        if path.name != "kustomization.yaml":
            yield from yaml.safe_load_all(path.read_text())


def containers(document: dict[str, Any]) -> list[dict[str, Any]]:
    if document["kind"] not in ("Deployment", "StatefulSet"):
        return []
    return list(document["spec"]["template"]["spec"]["containers"])
