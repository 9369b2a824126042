"""Many samples on one machine or a cluster, behind `concurrent.futures.Executor`."""
