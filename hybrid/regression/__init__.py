"""Linear regression of all joints together: columns, sums over samples, solutions."""
