"""The browser client: its source, and the room that serves what is built of it."""
