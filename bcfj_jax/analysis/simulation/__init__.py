"""One run of a scene: what ``bcfj simulate`` leaves behind, and what it says."""
