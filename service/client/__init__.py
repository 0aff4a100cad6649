"""A Python client of the HTTP service.

    from service.client import Client

    with Client("http://127.0.0.1:8000") as service:
        job = service.submit("scan.ply", {"preset": "draft"})
        job = service.wait(job.id)
        service.download(job, "mesh.glb", "mesh.glb")

`AsyncClient` has the same methods to await. What they answer is what the service's OpenAPI document
describes: the schemas are the service's own.
"""

from service.client.clients import AsyncClient, Client
from service.client.steps import Refused, Unreachable
from service.jobs.schemas import JobOut as Job

__all__ = ["AsyncClient", "Client", "Job", "Refused", "Unreachable"]
