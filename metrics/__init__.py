"""Images in, numbers out: fidelity of frames, steadiness over time and over views."""
