"""Many completed executions in lockstep, each with its own numbers, time, step and mode.

A `batch.Batch` of a `model.BatchModel` advances its lanes by one step a round and reports what
happened to them as `outcomes`.
"""
