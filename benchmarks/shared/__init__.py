"""What several suites use: results, scenes, rivals, statistics."""
