"""The nodes' processes: started, watched, and heard."""
