from tests.services import settings, shared_server

__all__ = ["settings", "shared_server"]
