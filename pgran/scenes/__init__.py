"""One file an experiment: options in, result out. Imported by name, each with what it needs."""
