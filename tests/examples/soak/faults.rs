//! The faults, as script lines of docs/mock-arm.md.

/// A kind of fault.
pub struct Fault {
    /// Name in the table.
    pub name: &'static str,
    /// Line that starts the fault; `AXIS` is a random axis.
    pub begin: &'static str,
    /// Line that ends the fault, if one is needed.
    pub end: Option<&'static str>,
    /// Both arms must be stationary within this time, milliseconds; none for a tolerated fault.
    pub rest_max_millis: Option<u64>,
}

/// Detected by controller or gateway: 30 ms down to speed 0, the lag of the drives, and 20 ms.
const AT_ONCE: u64 = 100;
/// Detected by missing messages: up to 50 ms (host and gateway wait for three messages, or that long), plus the above.
const SILENT: u64 = 150;
/// Detected by the joints: two wrong angles in a row, then brakes that close on a joint that does not follow commands.
const BY_JOINTS: u64 = 400;

const fn stops(name: &'static str, begin: &'static str, end: Option<&'static str>, rest_max_millis: u64) -> Fault {
    Fault { name, begin, end, rest_max_millis: Some(rest_max_millis) }
}

const fn borne(name: &'static str, begin: &'static str) -> Fault {
    Fault { name, begin, end: None, rest_max_millis: None }
}

/// All faults.
pub const FAULTS: [Fault; 27] = [
    stops("cable between host and gateway", "unplug", Some("plug"), AT_ONCE),
    stops("line silent", "line silence on", Some("line silence off"), SILENT),
    stops("line deaf", "line deaf on", Some("line deaf off"), SILENT),
    stops("frame of another arm", "line wrong-arm 1", None, AT_ONCE),
    stops("three frames lost", "line drop 3", None, SILENT),
    stops("frames 25 ms late", "line slow 25ms", Some("line slow 0s"), SILENT),
    stops("controller silent", "silence on", Some("silence off"), SILENT),
    stops("controller deaf", "deaf 20", Some("deaf 0"), SILENT),
    stops("three replies lost", "drop 3", Some("drop 0"), SILENT),
    stops("three replies damaged", "truncate 3", Some("truncate 0"), AT_ONCE),
    stops("three wrong sequence numbers", "wrong-sequence 3", Some("wrong-sequence 0"), AT_ONCE),
    stops("controller's own time-out", "time-out", None, AT_ONCE),
    stops("alarm of an axis", "alarm AXIS 0x0e", Some("alarm AXIS off"), AT_ONCE),
    stops("alarm, reported only", "alarm AXIS 0x09 reported", Some("alarm AXIS off"), AT_ONCE),
    stops("alarm of the controller", "controller-alarm 0x06", Some("controller-alarm off"), AT_ONCE),
    stops("emergency stop", "e-stop press", Some("e-stop release"), AT_ONCE),
    stops("limit switch", "limit-switch open", Some("limit-switch close"), AT_ONCE),
    stops("power lost", "power off", Some("power on"), AT_ONCE),
    stops("joint runs away", "runaway AXIS 2rad/s", Some("runaway AXIS off"), BY_JOINTS),
    stops("angle jumps", "jump AXIS 20deg", Some("jump AXIS -20deg"), BY_JOINTS),
    borne("one frame lost", "line drop 1"),
    borne("one frame twice", "line duplicate 1"),
    borne("one frame damaged", "line corrupt 1"),
    borne("one frame cut", "line truncate 1"),
    borne("one reply lost", "drop 1"),
    // Not `corrupt`: the bus checks its frames, so the host never gets a reply with a wrong bit.
    borne("one reply cut", "truncate 1"),
    borne("one reply twice", "duplicate 1"),
];
