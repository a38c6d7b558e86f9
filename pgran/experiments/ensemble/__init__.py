"""Many samples of any experiment; noise and transport over them."""
