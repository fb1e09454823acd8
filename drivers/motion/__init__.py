"""Playback of a sampled trajectory: on its path, held, resumed, braked."""
