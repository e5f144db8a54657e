"""The one way a policy is made ready: it is told who votes, and if it learns it is given training scenes.

What it is given leads to no truth of a scene that it is tested on. (Code that opens files, or digs in the interpreter,
cannot be stopped here.)
"""

from __future__ import annotations

from mixo_env.errors import PolicyError
from mixo_env.policies.agent import Frozen
from mixo_env.policies.policy import Policy
from mixo_env.policies.single import Single
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.complete import check_complete
from mixo_env.recordings.drives import drive_hash
from mixo_env.recordings.truths import for_learning


def prepare(policy: Policy, training: Recordings, track: str, *, seed: int = 0) -> None:
    """Start a policy, fit it if it learns, and note on which drives.

    Args:
        policy: new; one that does not learn gets the names of the voters and nothing else.
        training: scenes of the training folds.
        track: whose experts vote.
        seed: of whatever is random in the fit.

    Raises:
        RecordingError: where a true pose, a speed or a distance of the training scenes is no finite number.
    """
    policy.start(training.voters(track))
    if policy.learns:
        check_complete(training)
        policy.fit(for_learning(training), track, seed=seed)
        policy.fitted_on = drives(training)


def drives(recordings: Recordings) -> frozenset[str]:
    """Hashes of all drives of a recording."""
    return frozenset(drive_hash(recordings, i) for i in range(len(recordings)))


def check(policy: Policy, recordings: Recordings, track: str) -> None:
    """Refuse to play a policy where it does not fit, or where it was fitted.

    Raises:
        PolicyError: unless it weights exactly these voters in this order; when it holds anything learned and does not
            say on which drives; when one of them is among ``recordings``.
    """
    voters = recordings.voters(track)
    expected = policy.weighted(voters)
    shown = policy.policy if isinstance(policy, Frozen) else policy
    reference = (shown.name,) if type(shown) is Single else ()
    if expected not in (voters, (*voters, *reference)):
        raise PolicyError(
            f"{policy.name} would weight {', '.join(expected)} in track {track}, where {', '.join(voters)} vote: only "
            "a single expert, alone, may be shown without a vote"
        )
    if policy.experts != expected:
        raise PolicyError(
            f"{policy.name} was fitted for {', '.join(policy.experts) or 'nothing yet'}, but track {track} of these "
            f"recordings has {', '.join(expected)}, in this order: fit it on recordings with these experts"
        )
    if not (policy.learns or policy.tensors() or policy.fitted_on):
        return
    if not policy.fitted_on:
        raise PolicyError(f"{policy.name} does not say on which drives it was fitted: fit it with `prepare`")
    for i, scene in enumerate(recordings.scenes):
        if drive_hash(recordings, i) in policy.fitted_on:
            raise PolicyError(f"{policy.name} was fitted on the drive of {scene.name}: score it on other scenes")
