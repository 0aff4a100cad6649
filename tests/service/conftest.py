from tests.azure import azurite
from tests.objects import moto, place, rclone
from tests.services import own_server, redis, settings, shared_server

__all__ = [
    "azurite", "moto", "own_server", "place", "rclone", "redis", "settings", "shared_server",
]  # fmt: skip
