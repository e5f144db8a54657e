"""One judgement of a scene for two commands: ``mixo inspect`` prints it, ``mixo record`` acts on it.

A check is a function from :class:`~mixo_env.nuscenes.checks.evidence.Evidence` to findings, registered under a short
name in :mod:`~mixo_env.nuscenes.checks.judge`. A *problem* is something wrong with the data: the scene cannot be
recorded, or would be recorded wrongly. A *note* is worth knowing and does no harm.
"""
