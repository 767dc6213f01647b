"""What is wrong with a capture, or with renders: findings, each with its proof and its mend."""
