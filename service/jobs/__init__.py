"""The job: its record, its queue, its HTTP face."""
