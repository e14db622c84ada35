"""Makes FMUs of the models: it travels in none of them."""
