"""The virtual rig in real time: reads its end of the line, lives up to the present, answers."""

import gc
import time
from collections.abc import Callable

from hils.link.messages import Reason, RigState
from hils.rig_sim.endpoints import AbstractEnd
from hils.rig_sim.rig import RigStateChange, VirtualRig

# It looks at the time at least this often [s].
PERIOD = 1e-3


# Where it was held up for longer than this [s], a rig of metal would not have been: its time stood.
HELD_UP = 5e-3


def serve(
    rig: VirtualRig,
    end: AbstractEnd,
    say: Callable[[str], None],
    seconds: float = float("inf"),
) -> None:
    """Let the rig live on the monotonic clock, but for times when this program is not let run.

    Args:
        rig: Its power came at the present time of that clock.
        end: Where a host may plug in.
        say: Told of each change, a line a time.
        seconds: How long [s].
    """
    begun = rig.occasions["power"]
    last = told = begun - PERIOD
    stood = 0.0
    gc.collect()
    gc.freeze()
    while time.monotonic() < begun + seconds:
        if rig.is_plugged:
            end.plug()
        else:
            end.unplug()
        data = end.read()
        now = time.monotonic() - stood
        if now > last + HELD_UP:
            # What has come meanwhile would have been heard in time.
            stood += now - (last + PERIOD)
            now = last + PERIOD
        out = rig.advance_unplugged(now, data)
        if out:
            end.write(out)
        last = now
        while rig.changes and rig.changes[-1].time > told:
            fresh = [each for each in rig.changes if each.time > told]
            told = fresh[-1].time
            for change in fresh:
                say(change_sentence(change, begun))
        end.wait(min(PERIOD, rig.next_event() + stood - time.monotonic()))


def change_sentence(change: RigStateChange, begun: float) -> str:
    """A change of the rig's state, as a person is told.

    Args:
        change: What changed.
        begun: Time that counts as zero [s].
    """
    state = RigState(change.state).name
    when = f"{change.time - begun:10.3f} s  {state}"
    if change.reason == Reason.NONE:
        return when
    known = {int(each): each.name for each in Reason}
    reason = known.get(change.reason, str(change.reason)).lower().replace("_", " ")
    return f"{when} ({reason}, {change.silence * 1e3:.1f} ms after the host's last word)"
