"""From a request body to an input in the artefact store."""
