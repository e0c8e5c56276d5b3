//! Every finding, on made-up machines.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use pb3dp_setup::layers::SetupArgs;

use pb3dp_cell::finding::{Finding, Verdict};

use super::needs::{Cameras, Needs};
use super::report::Report;
use super::system::{Node, System, Tree};
use super::{access, findings};

/// A machine: files in a folder, and answers.
struct Fake {
    folder: tempfile::TempDir,
    nodes: BTreeMap<String, Node>,
    fifo: Result<(), String>,
    memory: Result<(), String>,
    free: Result<u64, String>,
}

/// A device that its group may use; of the group dialout or video.
fn device(gid: u32) -> Node {
    Node { mode: 0o660, uid: 0, gid, is_device: true }
}

const DIALOUT: u32 = 20;
const VIDEO: u32 = 44;

impl Fake {
    /// A machine on which everything passes: two cameras, one adapter, one ARCNET card.
    fn good() -> Self {
        let mut fake = Self {
            folder: tempfile::tempdir().unwrap(),
            nodes: BTreeMap::new(),
            fifo: Ok(()),
            memory: Ok(()),
            free: Ok(100_000_000_000),
        };
        fake.user(1000, "20 44 990", "00000000000020c0");
        fake.file("/etc/group", "root:x:0:\ndialout:x:20:vision\nvideo:x:44:vision\nrealtime:x:990:vision\n");
        fake.file("/proc/sys/kernel/sched_rt_runtime_us", "950000\n");
        fake.file("/proc/sys/kernel/sched_rt_period_us", "1000000\n");
        fake.file("/proc/sys/kernel/osrelease", "6.1.0-9\n");
        fake.file("/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n");
        fake.file("/sys/devices/system/clocksource/clocksource0/available_clocksource", "tsc hpet acpi_pm\n");
        for cpu in ["cpu0", "cpu1"] {
            fake.file(&format!("/sys/devices/system/cpu/{cpu}/cpufreq/scaling_governor"), "performance\n");
        }
        fake.file("/sys/devices/system/cpu/cpufreq/scaling_governor", "no processor");
        fake.file("/lib/modules/6.1.0-9/modules.dep", "kernel/drivers/net/arcnet/arc-rawmode.ko: kernel/drivers/net/arcnet/arcnet.ko\nkernel/drivers/usb/serial/ftdi_sio.ko.xz:\n");
        fake.file("/lib/modules/6.1.0-9/modules.builtin", "kernel/drivers/usb/class/cdc-acm.ko\n");
        for module in ["uvcvideo", "arcnet"] {
            fake.nodes.insert(format!("/sys/module/{module}"), Node { mode: 0o755, uid: 0, gid: 0, is_device: false });
        }
        fake.camera(0, "usb1/1-2", "480");
        fake.camera(2, "usb3/3-1/3-1.4", "480");
        fake.adapter("ttyUSB0", "1");
        fake.card("arc0", "7", "0x1043");
        fake
    }

    fn file(&self, path: &str, text: &str) {
        let place = self.folder.path().join(path.trim_start_matches('/'));
        fs::create_dir_all(place.parent().unwrap()).unwrap();
        fs::write(place, text).unwrap();
    }

    fn remove(&self, path: &str) {
        let place = self.folder.path().join(path.trim_start_matches('/'));
        if place.is_dir() { fs::remove_dir_all(place).unwrap() } else { fs::remove_file(place).unwrap() }
    }

    fn link(&self, path: &str, target: &str) {
        let place = |path: &str| self.folder.path().join(path.trim_start_matches('/'));
        fs::create_dir_all(place(path).parent().unwrap()).unwrap();
        fs::create_dir_all(place(target).parent().unwrap()).unwrap();
        symlink(place(target), place(path)).unwrap();
    }

    fn user(&self, uid: u32, groups: &str, capabilities: &str) {
        let status = format!(
            "Name:\tpb3dp\nUid:\t{uid}\t{uid}\t{uid}\t{uid}\nGid:\t{uid}\t{uid}\t{uid}\t{uid}\nGroups:\t{groups} \nCapEff:\t{capabilities}\n"
        );
        self.file("/proc/self/status", &status);
    }

    fn camera(&mut self, number: u32, place: &str, speed: &str) {
        let port = place.rsplit('/').next().unwrap();
        let device = format!("/sys/devices/pci0000:00/0000:00:14.0/{place}");
        self.file(&format!("{device}/speed"), speed);
        self.file(&format!("{device}/{port}:1.0/bInterfaceClass"), "0e");
        for (name, index) in [(format!("video{number}"), "0"), (format!("video{}", number + 1), "1")] {
            self.link(&format!("/sys/class/video4linux/{name}/device"), &format!("{device}/{port}:1.0"));
            self.file(&format!("/sys/class/video4linux/{name}/index"), index);
            self.file(&format!("/sys/class/video4linux/{name}/name"), "HD Camera");
            self.nodes.insert(format!("/dev/{name}"), device_of_video());
        }
    }

    fn adapter(&mut self, name: &str, timer: &str) {
        self.file(&format!("/dev/{name}"), "");
        self.link(&format!("/dev/serial/by-id/usb-FTDI_{name}"), &format!("/dev/{name}"));
        self.nodes.insert(format!("/dev/{name}"), device(DIALOUT));
        self.nodes.insert(format!("/dev/serial/by-id/usb-FTDI_{name}"), device(DIALOUT));
        self.file(&format!("/sys/bus/usb-serial/devices/{name}/latency_timer"), timer);
    }

    fn card(&self, name: &str, kind: &str, flags: &str) {
        self.file(&format!("/sys/class/net/{name}/type"), kind);
        self.file(&format!("/sys/class/net/{name}/flags"), flags);
    }
}

fn device_of_video() -> Node {
    device(VIDEO)
}

impl System for Fake {
    fn text(&self, path: &str) -> Option<String> {
        Tree::new(self.folder.path()).text(path)
    }
    fn names(&self, folder: &str) -> Vec<String> {
        Tree::new(self.folder.path()).names(folder)
    }
    fn target(&self, path: &str) -> Option<String> {
        Tree::new(self.folder.path()).target(path)
    }
    fn node(&self, path: &str) -> Option<Node> {
        self.nodes.get(path).copied()
    }
    fn try_fifo(&self, _: u8) -> Result<(), String> {
        self.fifo.clone()
    }
    fn try_memory_lock(&self) -> Result<(), String> {
        self.memory.clone()
    }
    fn free_bytes(&self, _: &Path) -> Result<u64, String> {
        self.free.clone()
    }
}

/// What a rig with one arm at a serial port, and the gateway of the other one, needs.
fn rig() -> Needs {
    Needs {
        source: "cell.toml (pb3dp run)".to_owned(),
        needs_realtime: true,
        serial: Some(vec!["/dev/serial/by-id/usb-FTDI_ttyUSB0".to_owned()]),
        arcnet: vec!["arc0".to_owned()],
        ..general()
    }
}

fn general() -> Needs {
    Needs::general(PathBuf::from("out"))
}

/// The findings that do not pass.
fn bad(fake: &Fake, needs: &Needs) -> Vec<Finding> {
    findings(fake, needs).into_iter().filter(|finding| finding.verdict != Verdict::Pass).collect()
}

/// The one finding that does not pass: its verdict, and parts of what it says and advises.
fn only(fake: &Fake, needs: &Needs, check: &str, verdict: Verdict, found: &str, advice: &str) {
    let bad = bad(fake, needs);
    let [one] = &bad[..] else { panic!("one finding of {check} was expected: {bad:#?}") };
    assert_eq!((one.check.as_str(), one.verdict), (check, verdict), "{one:?}");
    assert!(one.found.contains(found), "{found:?} is missing: {one:?}");
    assert!(one.advice.as_ref().unwrap().contains(advice), "{advice:?} is missing: {one:?}");
}

#[test]
fn a_good_machine_passes() {
    for needs in [rig(), general()] {
        let report = Report::of(findings(&Fake::good(), &needs));
        assert_eq!(report.worst, Verdict::Pass, "{}", report.text());
        assert_eq!(report.exit_code(), 0);
        assert!(report.findings.iter().all(|finding| finding.advice.is_none()));
        // Two cameras, whose metadata nodes are not cameras.
        assert_eq!(report.findings.iter().filter(|finding| finding.check == "cameras").count(), 2);
    }
}

#[test]
fn what_real_time_lacks_is_found() {
    let refused = || Err("not available (EPERM)".to_owned());
    let (live, perhaps) = (rig(), general());
    let fake = Fake { fifo: refused(), ..Fake::good() };
    only(&fake, &live, "real-time scheduling", Verdict::Fail, "EPERM", "90-pb3dp.conf");
    only(&fake, &perhaps, "real-time scheduling", Verdict::Warning, "EPERM", "usermod -aG realtime");
    let fake = Fake { memory: refused(), ..Fake::good() };
    only(&fake, &live, "memory lock", Verdict::Fail, "EPERM", "90-pb3dp.conf");

    let fake = Fake::good();
    fake.file("/proc/sys/kernel/sched_rt_runtime_us", "0\n");
    only(&fake, &live, "real-time throttling", Verdict::Fail, "no processor time", "950000");
    fake.file("/proc/sys/kernel/sched_rt_runtime_us", "500000\n");
    only(&fake, &live, "real-time throttling", Verdict::Warning, "50 %", "950000");
    fake.file("/proc/sys/kernel/sched_rt_runtime_us", "-1\n");
    assert_eq!(bad(&fake, &live), []);
}

#[test]
fn clocks_and_governors_are_judged() {
    let (fake, clock) = (Fake::good(), "/sys/devices/system/clocksource/clocksource0/current_clocksource");
    fake.file(clock, "hpet\n");
    only(&fake, &rig(), "clock source", Verdict::Warning, "hpet", "available: tsc hpet acpi_pm");
    fake.remove(clock);
    only(&fake, &rig(), "clock source", Verdict::Warning, "cannot be read", "log");

    let fake = Fake::good();
    fake.file("/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave\n");
    only(&fake, &rig(), "processor frequency", Verdict::Warning, "performance, powersave", "cpupower");
    for cpu in ["cpu0", "cpu1"] {
        fake.remove(&format!("/sys/devices/system/cpu/{cpu}/cpufreq"));
    }
    assert_eq!(bad(&fake, &rig()), []);
}

#[test]
fn groups_are_looked_for() {
    let fake = Fake::good();
    fake.user(1000, "20 44", "00000000000020c0");
    only(&fake, &rig(), "groups", Verdict::Warning, "not in group realtime", "usermod -aG realtime");
    fake.user(0, "0", "000001ffffffffff");
    assert_eq!(bad(&fake, &rig()), []);
    fake.file("/etc/group", "dialout:x:20:\nvideo:x:44:\n");
    only(&fake, &rig(), "groups", Verdict::Warning, "no group realtime", "systemd-sysusers");
    fake.remove("/proc/self/status");
    let found = access::check(&fake, &["realtime"]);
    assert_eq!(found[0].verdict, Verdict::Fail);
}

#[test]
fn serial_ports_that_do_not_serve_are_found() {
    const PORT: &str = "/dev/serial/by-id/usb-FTDI_ttyUSB0";
    let check = "serial ports";
    let with = |port: &str| Needs { serial: Some(vec![port.to_owned()]), ..rig() };
    only(&Fake::good(), &with("/dev/serial/by-id/usb-other"), check, Verdict::Fail, "usb-other does not exist", PORT);
    only(&Fake::good(), &with("/dev/ttyUSB0"), check, Verdict::Warning, "connected first", "by-id");

    let mut fake = Fake::good();
    fake.nodes.insert(PORT.to_owned(), Node { gid: 1234, ..device(0) });
    only(&fake, &rig(), check, Verdict::Fail, "group 1234", "70-pb3dp.rules");
    fake.nodes.insert(PORT.to_owned(), Node { mode: 0o600, ..device(DIALOUT) });
    only(&fake, &rig(), check, Verdict::Fail, "mode 600", "70-pb3dp.rules");
    fake.nodes.insert(PORT.to_owned(), Node { is_device: false, ..device(DIALOUT) });
    only(&fake, &rig(), check, Verdict::Fail, "is not a device", "correct the name");

    let fake = Fake::good();
    fake.user(1000, "44 990", "00000000000020c0");
    let found = bad(&fake, &rig());
    assert_eq!(found.len(), 2, "the group and the port: {found:?}");
    assert!(found[1].advice.as_ref().unwrap().contains("usermod -aG dialout"), "{found:?}");

    let fake = Fake::good();
    fake.file("/sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n");
    only(&fake, &rig(), "serial latency", Verdict::Warning, "16 ms", "echo 1 > /sys/bus/usb-serial/devices/ttyUSB0");
    only(&fake, &general(), "serial latency", Verdict::Warning, "16 ms", "70-pb3dp.rules");

    let mut fake = Fake::good();
    fake.remove("/dev/serial");
    fake.nodes.remove(PORT);
    only(&fake, &rig(), check, Verdict::Fail, "does not exist", "dmesg");
    let toy = Needs { serial: Some(Vec::new()), ..rig() };
    assert_eq!(bad(&fake, &toy), []);
    fake.remove("/dev/ttyUSB0");
    assert_eq!(bad(&fake, &general()), []);
}

#[test]
fn cameras_that_do_not_serve_are_found() {
    let mut fake = Fake::good();
    fake.nodes.insert("/dev/video0".to_owned(), Node { mode: 0o660, uid: 0, gid: 0, is_device: true });
    only(&fake, &general(), "cameras", Verdict::Warning, "/dev/video0", "70-pb3dp.rules");
    fake.nodes.remove("/dev/video0");
    only(&fake, &general(), "cameras", Verdict::Warning, "has no device file", "udev");
    fake.remove("/sys/class/video4linux");
    only(&fake, &general(), "cameras", Verdict::Warning, "no camera is connected", "lsusb");
    assert_eq!(bad(&fake, &Needs { cameras: Cameras::NotNeeded, ..rig() }), []);
}

#[test]
fn the_cameras_of_a_setup_are_looked_for_by_name() {
    let with = |left: &str, right: &str| {
        let names = [left, right].map(|name| name.parse().unwrap());
        Needs { cameras: Cameras::These(names), ..rig() }
    };
    let mut fake = Fake::good();
    fake.file("/sys/devices/pci0000:00/0000:00:14.0/usb1/1-2/serial", "4F5A19C0");
    let left = "bus:usb-0000:00:14.0-2";
    for right in ["bus:usb-0000:00:14.0-1.4", "/dev/video2"] {
        assert_eq!(bad(&fake, &with(left, right)), []);
        assert_eq!(bad(&fake, &with("serial:4F5A19C0", right)), []);
    }
    let gone = with(left, "bus:usb-0000:00:14.0-3");
    only(
        &fake,
        &gone,
        "cameras",
        Verdict::Fail,
        "the right camera, bus:usb-0000:00:14.0-3, is not connected",
        "usb-0000:00:14.0-1.4",
    );
    let same = with(left, "/dev/video0");
    only(&fake, &same, "cameras", Verdict::Fail, "left and right are the same camera", "its own camera");
    let other = with(left, "bus:platform:vivid-001");
    only(&fake, &other, "cameras", Verdict::Warning, "bus:platform:vivid-001", "pb3dp cameras list");
    // One device may have both views.
    let one = |name: &str| Needs { cameras: Cameras::One(name.parse().unwrap()), ..rig() };
    assert_eq!(bad(&fake, &one(left)), []);
    let gone = "bus:usb-0000:00:14.0-3";
    only(
        &fake,
        &one(gone),
        "cameras",
        Verdict::Fail,
        "the camera, bus:usb-0000:00:14.0-3, is not connected",
        "left.device",
    );
    let nominal = Needs { nominal_calibration: Some("none: a drawing".to_owned()), ..with(left, "/dev/video2") };
    only(&fake, &nominal, "calibration", Verdict::Warning, "(none: a drawing)", "--nominal-calibration");
    fake.nodes.insert("/dev/video2".to_owned(), Node { mode: 0o660, uid: 0, gid: 0, is_device: true });
    only(&fake, &with(left, "/dev/video2"), "cameras", Verdict::Fail, "/dev/video2", "70-pb3dp.rules");
    // One that nobody asked for may be as it is.
    fake.camera(4, "usb1/1-4", "480");
    only(&fake, &with(left, "/dev/video2"), "cameras", Verdict::Fail, "/dev/video2", "70-pb3dp.rules");
}

#[test]
fn cameras_that_share_a_slow_bus_are_found() {
    let mut fake = Fake::good();
    fake.remove("/sys/class/video4linux/video2");
    fake.remove("/sys/class/video4linux/video3");
    fake.camera(2, "usb1/1-4/1-4.1", "480");
    only(&fake, &general(), "USB topology", Verdict::Warning, "share usb1 of the controller 0000:00:14.0", "MJPG");
    for (number, place) in [(0, "usb1/1-2"), (2, "usb1/1-4/1-4.1")] {
        fake.file(&format!("/sys/devices/pci0000:00/0000:00:14.0/{place}/speed"), "5000\n");
        assert!(number < 3);
    }
    assert_eq!(bad(&fake, &general()), []);
    fake.file("/sys/devices/pci0000:00/0000:00:14.0/usb1/1-2/speed", "12\n");
    let found = bad(&fake, &general());
    assert_eq!((found[0].verdict, found[0].check.as_str()), (Verdict::Fail, "USB topology"), "{found:?}");
    assert!(found[0].found.contains("/dev/video0 runs at 12 Mbit/s"), "{found:?}");
}

#[test]
fn drivers_that_are_not_there_are_found() {
    let mut fake = Fake::good();
    fake.nodes.remove("/sys/module/uvcvideo");
    only(&fake, &general(), "kernel modules", Verdict::Warning, "uvcvideo", "modprobe uvcvideo");
    let mut fake = Fake::good();
    fake.nodes.remove("/sys/module/arcnet");
    fake.file("/lib/modules/6.1.0-9/modules.dep", "kernel/ftdi_sio.ko:\n");
    let found = bad(&fake, &rig());
    assert_eq!(found.iter().filter(|one| one.check == "kernel modules" && one.verdict == Verdict::Fail).count(), 2);
}

#[test]
fn an_arcnet_interface_that_does_not_serve_is_found() {
    let check = "ARCNET";
    let named = |name: &str| Needs { arcnet: vec![name.to_owned()], ..rig() };
    only(&Fake::good(), &named("arc1"), check, Verdict::Fail, "no network interface arc1", "existing interfaces: arc0");
    let fake = Fake::good();
    fake.card("eth0", "1", "0x1003");
    only(&fake, &named("eth0"), check, Verdict::Fail, "type 1", "link/arcnet");
    fake.card("arc0", "7", "0x1042");
    only(&fake, &rig(), check, Verdict::Fail, "arc0 is down", "ip link set arc0 up");
    fake.remove("/sys/class/net/arc0");
    only(&fake, &rig(), check, Verdict::Fail, "no network interface arc0", "modprobe -a com20020_pci");
    assert_eq!(bad(&fake, &Needs { arcnet: Vec::new(), ..rig() }), []);
    let fake = Fake::good();
    fake.user(1000, "20 44 990", "0000000000000000");
    only(&fake, &rig(), check, Verdict::Fail, "cannot open packet sockets", "setcap cap_net_raw");
    only(&fake, &general(), check, Verdict::Warning, "cannot open packet sockets", "pb3dp-gateway@.service");
}

#[test]
fn signals_that_nothing_notices_are_named() {
    let unknown =
        |keys: &[&str]| Needs { unknown_signals: Some(keys.iter().map(|key| (*key).to_owned()).collect()), ..rig() };
    let one = unknown(&["arms.vs.gateway.signals.power"]);
    let check = "signals of the arms";
    only(
        &Fake::good(),
        &one,
        check,
        Verdict::Fail,
        "no brake opens: arms.vs.gateway.signals.power",
        "pb3dp arm signals",
    );
    assert_eq!(bad(&Fake::good(), &unknown(&[])), []);
    // The signals of format A are learnt at the arm.
    let text = std::fs::read_to_string("../../configs/gateway.toml").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm1.toml");
    let needs = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let config = SetupArgs { configs: vec![file.clone()], ..SetupArgs::default() };
        Needs::of_config(&config, PathBuf::from("out")).unwrap().unknown_signals.unwrap()
    };
    assert_eq!(needs(&text), [""; 0]);
    let from = text.find("emergency_stop = ").unwrap();
    let end = from + text[from..].find('\n').unwrap();
    assert_eq!(needs(&text.replace(&text[from..end], "emergency_stop = \"unknown\"")), ["arm.signals.emergency_stop"]);
}

#[test]
fn room_for_recordings_is_counted_in_minutes() {
    let check = "space for recordings";
    let with = |free| Fake { free, ..Fake::good() };
    only(
        &with(Ok(10_000_000_000)),
        &rig(),
        check,
        Verdict::Warning,
        "10.0 GB free, enough for 3 minutes",
        "--recordings",
    );
    only(&with(Ok(3_000_000_000)), &rig(), check, Verdict::Fail, "3.0 GB", "free some space");
    only(&with(Err("EIO".to_owned())), &rig(), check, Verdict::Fail, "EIO", "another folder");
}

#[test]
fn the_worst_finding_decides() {
    let finding = [Finding::pass("a", "b"), Finding::fail("c", "d", "e"), Finding::warning("f", "g", "h")];
    let report = Report::of(finding.to_vec());
    assert_eq!((report.worst, report.exit_code()), (Verdict::Fail, 2));
    let text = report.text();
    assert!(
        text.contains("FAIL     c: d\n         -> e\n") && text.ends_with("1 passed, 1 warnings, 1 failed"),
        "{text}"
    );
    assert_eq!(Report::of(finding[2..].to_vec()).exit_code(), 1);
}

#[test]
fn needs_come_from_the_configuration() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let of = |name: &str| Needs::of_config(&SetupArgs::of_file(&root.join(name)), PathBuf::from("out")).unwrap();
    let gateway = of("gateway.toml");
    assert_eq!((gateway.priority, gateway.needs_realtime, &gateway.arcnet[..]), (80, true, &["arc0".to_owned()][..]));
    assert_eq!((&gateway.serial, &gateway.cameras), (&Some(Vec::new()), &Cameras::NotNeeded));
    assert!(
        gateway.keys.as_ref().unwrap().as_ref().is_err_and(|why| why.contains("access.key_file")),
        "no key is shipped"
    );
    let gateway = Needs { keys: None, ..gateway };
    let full = Fake { free: Ok(0), ..Fake::good() };
    assert_eq!(bad(&full, &gateway), [], "a gateway records nothing");
    let emulated = of("hil.toml");
    assert_eq!((emulated.needs_realtime, &emulated.serial, emulated.arcnet.len()), (false, &Some(Vec::new()), 0));
    assert!((emulated.recording_bytes_per_s / 55.3e6 - 1.0).abs() < 0.01);
    let rig = of("rig.toml");
    let names = ["bus:usb-0000:00:14.0-1", "bus:usb-0000:00:14.0-2"].map(|name| name.parse().unwrap());
    assert_eq!((rig.needs_realtime, &rig.cameras), (true, &Cameras::These(names)));
    assert!(
        rig.nominal_calibration.as_ref().is_some_and(|says| says.starts_with("none"))
            && emulated.nominal_calibration.is_none()
    );
    assert!(rig.serial.as_ref().unwrap().len() == 2 && rig.groups() == ["realtime", "video", "dialout"]);
    let cameras = of("../crates/orchestrator/src/commands/config/cameras.toml");
    assert!(!cameras.needs_realtime && matches!(cameras.cameras, Cameras::These(_)), "{cameras:?}");
    assert_eq!((&cameras.serial, cameras.groups()), (&Some(Vec::new()), vec!["video"]));
    // There is no such file yet.
    assert!(cameras.nominal_calibration.is_some_and(|says| says.contains("calibration.toml")));
    assert!(of("sim.toml").groups().is_empty() && emulated.groups().is_empty());
    assert_eq!(Needs::general(PathBuf::from("out")).groups(), ["realtime", "video", "dialout"]);
    let missing = Needs::of_config(&SetupArgs::of_file(&root.join("no such file.toml")), PathBuf::from("out"));
    assert!(missing.unwrap_err().to_string().contains("no such file.toml"));
    let other = Needs::of_config(&SetupArgs::of_file(&root.join("estimator.toml")), PathBuf::from("out"));
    assert!(other.unwrap_err().to_string().contains("estimator"));
}

#[test]
fn keys_of_tcp_lines_are_for_this_user_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (file, key) = (folder.path().join("arm1.toml"), folder.path().join("arm1.key"));
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/gateway.toml");
    fs::copy(shipped, &file).unwrap();
    pb3dp_hal_platform::key_file::write_new_key(&key).unwrap();
    let needs = || Needs::of_config(&SetupArgs::of_file(&file), PathBuf::from("out")).unwrap();
    let failed = |part: &str| only(&Fake::good(), &needs(), "key files", Verdict::Fail, part, "docs/gateway.md");
    assert_eq!(bad(&Fake::good(), &needs()), []);
    fs::set_permissions(&key, fs::Permissions::from_mode(0o640)).unwrap();
    failed("its mode is 0640");
}

#[test]
fn sockets_between_host_and_gateway_are_there_or_can_be_made() {
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let gateway = fs::read_to_string(configs.join("gateway.toml")).unwrap();
    fs::write(in_folder("arm1.toml"), gateway.replace("tcp:127.0.0.1:4534", "local:run/arm1.sock")).unwrap();
    let arm = |line: &str| match line.split_once(" = ").map_or("", |(key, _)| key) {
        "backend" => "backend = \"local\"".to_owned(),
        "port" => {
            format!("socket = {:?}", in_folder(if line.contains("ARM1") { "run/arm1.sock" } else { "run/arm2.sock" }))
        }
        "baud" => String::new(),
        _ => line.replace("../", concat!(env!("CARGO_MANIFEST_DIR"), "/../../")),
    };
    let setup = fs::read_to_string(configs.join("rig.toml")).unwrap();
    fs::write(in_folder("host.toml"), setup.lines().map(arm).collect::<Vec<_>>().join("\n")).unwrap();
    let host = SetupArgs::of_file(&in_folder("host.toml"));
    let of = |config: &SetupArgs| Needs::of_config(config, PathBuf::from("out")).unwrap().sockets.unwrap();
    let of_gateway = || of(&SetupArgs::of_file(&in_folder("arm1.toml")));
    assert!(of_gateway().unwrap_err().contains("run does not exist"));
    fs::create_dir(in_folder("run")).unwrap();
    fs::set_permissions(in_folder("run"), fs::Permissions::from_mode(0o755)).unwrap();
    assert_eq!(of_gateway(), Ok(()));
    assert!(of(&host).unwrap_err().contains("no program listens"));
    fs::write(in_folder("run/arm1.sock"), "").unwrap();
    assert!(of(&host).unwrap_err().contains("a file") && of_gateway().unwrap_err().contains("a file"));
    fs::remove_file(in_folder("run/arm1.sock")).unwrap();
    let sockets = ["run/arm1.sock", "run/arm2.sock"];
    let _gateways = sockets.map(|name| std::os::unix::net::UnixListener::bind(in_folder(name)).unwrap());
    assert_eq!([of(&host), of_gateway()], [Ok(()), Ok(())]);
    let needs = Needs { sockets: Some(Err("nobody".to_owned())), ..rig() };
    only(&Fake::good(), &needs, "local sockets", Verdict::Fail, "nobody", "docs/gateway.md");
}

#[test]
fn a_gateway_unit_with_a_wider_sandbox_is_found() {
    let check = "gateway service";
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/deploy/pb3dp-gateway@.service");
    let shipped = fs::read_to_string(shipped).unwrap();
    let needs = Needs { is_gateway: true, ..rig() };
    let fake = Fake::good();
    assert_eq!(bad(&fake, &needs), [], "no unit is installed");
    let unit = "/etc/systemd/system/pb3dp-gateway@.service";
    fake.file(unit, &shipped);
    assert_eq!(bad(&fake, &needs), []);
    fake.file(unit, &shipped.replace("MemoryDenyWriteExecute=yes\n", ""));
    only(&fake, &needs, check, Verdict::Warning, "MemoryDenyWriteExecute=, not yes", "daemon-reload");
    assert_eq!(bad(&fake, &rig()), [], "the computer of a run has no such unit");
    fake.file(unit, &shipped);
    fake.file("/etc/systemd/system/pb3dp-gateway@.service.d/more.conf", "[Service]\nUser=root\n");
    only(&fake, &needs, check, Verdict::Warning, "User=root, not pb3dp", "pb3dp-gateway@.service.d");
}
