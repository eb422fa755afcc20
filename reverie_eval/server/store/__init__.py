"""What the server keeps: rows in a database, uploads by their digest."""
