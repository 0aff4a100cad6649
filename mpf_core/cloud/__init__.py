"""Point clouds: strict readers, the cloud itself, the normalised frame, neighbourhoods."""
