"""The dynamic structure factor S(q, omega): which sound waves a medium has, how they scatter."""
