"""The organiser's commands: set up, check, run, back up and restore a server."""
