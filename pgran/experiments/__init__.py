"""The experiments, a folder each; `pgran.catalogue` lists them."""
