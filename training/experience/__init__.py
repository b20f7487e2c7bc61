"""Experience: the collection of episodes and the buffers that batches are drawn from."""
