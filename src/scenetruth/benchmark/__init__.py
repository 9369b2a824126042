"""The benchmark suite: accuracy of estimation methods, case by case, beside the Cramér-Rao bound."""

from scenetruth.benchmark.benchmark_result import BenchmarkResult
from scenetruth.benchmark.suite import compare

__all__ = ["BenchmarkResult", "compare"]
