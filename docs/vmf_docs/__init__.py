"""What `make docs` does: run the tutorial, write the reference, check links, build HTML."""
