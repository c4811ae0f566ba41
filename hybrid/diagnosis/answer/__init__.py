"""The answer: findings, shrinkage, and a simulator that has them."""
