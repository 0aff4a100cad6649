"""The worker as it is shipped."""

from service.settings import Settings
from worker.main import run_worker

if __name__ == "__main__":
    run_worker(Settings())
