from tests.services import own_server, redis, settings, shared_server

__all__ = ["own_server", "redis", "settings", "shared_server"]
