"""One file a kind of recording; found through pyproject.toml's entry points `polemap.readers`."""
