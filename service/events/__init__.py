"""What happens to a job, as a stream that can be read again from any point."""
