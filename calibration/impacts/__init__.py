"""Records of impacts: contacts in them, samples that may be fitted, and what they say of masses, speeds and sensors."""
