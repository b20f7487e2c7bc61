"""Hold an elastic rod made of links against a continuous one."""
