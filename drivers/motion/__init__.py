"""How a sampled trajectory is played: on its path, held, resumed, braked."""
