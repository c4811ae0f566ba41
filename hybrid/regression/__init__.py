"""Linear regression over all joints: columns, cross-products, estimators, intervals."""
