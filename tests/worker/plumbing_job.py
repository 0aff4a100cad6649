"""The job process of `plumbing.py`."""

from tests.worker.plumbing import main_of_job

if __name__ == "__main__":
    main_of_job()
