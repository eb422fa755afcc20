"""Wire formats: the types of files and of HTTP requests and replies."""
