"""One file a kind of recording; found through the entry points `polemap.readers`."""
