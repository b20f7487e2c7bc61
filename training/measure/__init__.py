"""Success of controllers, on plants and in engines, and the statistics of it."""
