"""The virtual rig in real time: reads its end of the line, advances to the present, answers."""

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass

from hils.link.messages import Reason, RigState
from hils.rig_sim.endpoints import AbstractEnd
from hils.rig_sim.rig import RigStateChange, VirtualRig


@dataclass(frozen=True)
class ServerSettings:
    """Rhythm of a virtual rig in real time.

    Attributes:
        poll_interval: From one look at the clock to the next, at most [s].
        held_up_time: Delay of a look over which the rig's time counts as having stood [s]: a rig
            of metal would not have been held up.
    """

    poll_interval: float = 1e-3
    held_up_time: float = 5e-3


DEFAULT_SERVER = ServerSettings()


def serve(
    rig: VirtualRig,
    end: AbstractEnd,
    say: Callable[[str], None],
    seconds: float = float("inf"),
    settings: ServerSettings = DEFAULT_SERVER,
) -> None:
    """Run the rig on the monotonic clock, but for times when this program is not let run.

    Args:
        rig: Its power came at the present time of that clock.
        end: Of the line, at which a host may plug in.
        say: Takes a line for each change.
        seconds: Duration [s].
        settings: Rhythm.
    """
    begun, period = rig.occasions["power"], settings.poll_interval
    last = reported = begun - period
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
        if now > last + settings.held_up_time:
            # What has come meanwhile would have been heard in time.
            stood += now - (last + period)
            now = last + period
        out = rig.advance_unplugged(now, data)
        if out:
            end.write(out)
        last = now
        while rig.changes and rig.changes[-1].time > reported:
            fresh = [each for each in rig.changes if each.time > reported]
            reported = fresh[-1].time
            for change in fresh:
                say(change_sentence(change, begun))
        end.wait(min(period, rig.next_event() + stood - time.monotonic()))


def change_sentence(change: RigStateChange, begun: float) -> str:
    """Word a change of the rig's state for a person.

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
