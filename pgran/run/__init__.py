"""One run: what it is asked, its ranks, its journal, its end."""
