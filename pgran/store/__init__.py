"""Records: declared once, written, checked, read, said in SI."""
