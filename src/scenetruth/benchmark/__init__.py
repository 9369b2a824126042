"""The benchmark suite: accuracy of estimation methods by case, compared with the Cramér-Rao bound."""

from scenetruth.benchmark.benchmark_result import BenchmarkResult
from scenetruth.benchmark.suite import compare

__all__ = ["BenchmarkResult", "compare"]
