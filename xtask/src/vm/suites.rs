//! The test suites in emulated computers, with their hardware.

/// A test suite in one emulated computer.
pub struct Suite {
    /// The name on the command line, and the argument of the guest's program.
    pub name: &'static str,
    /// Description.
    pub what: &'static str,
    /// Package of the guest's program.
    pub package: &'static str,
    /// Name of the guest's program: an example of that package.
    pub example: &'static str,
    /// Whether the product itself is included, as `/bin/pb3dp`, with the files of `configs`.
    pub has_product: bool,
    /// QEMU's name of the processor: a plain one is emulated fastest, one with long vectors counts fewer instructions for the same work.
    pub processor: &'static str,
    /// Modules loaded before the program starts.
    pub modules: &'static [&'static str],
    /// Modules that the program loads itself.
    pub modules_by_hand: &'static [&'static str],
    /// Arguments of the kernel.
    pub kernel_arguments: &'static str,
    /// Options of QEMU with their values; FOLDER is the folder of its sockets.
    pub fixed: &'static [&'static str],
    /// Devices that the program may unplug.
    pub pluggable: &'static [Device],
}

/// A device that can be unplugged.
pub struct Device {
    pub name: &'static str,
    /// Arguments as on QEMU's command line.
    pub what: &'static str,
}

const PLAIN: &str = "qemu64";
const WITH_VECTORS: &str = "max,la57=off,erms=off,fsrm=off";

/// All suites.
pub const SUITES: [Suite; 5] = [
    Suite {
        name: "serial",
        what: "serial ports of an arm: USB adapters, a 16550, a cable that is unplugged",
        package: "pb3dp-arm-pa10",
        example: "arm_guest",
        has_product: false,
        processor: PLAIN,
        modules: &["xhci_pci", "ftdi_sio", "configfs", "dummy_hcd", "usb_f_acm", "cdc_acm"],
        modules_by_hand: &[],
        kernel_arguments: "",
        // Two adapters at the ends of one cable, and a built-in port without connection.
        fixed: &[
            "-device qemu-xhci,id=usb",
            "-chardev socket,id=cable-host,path=FOLDER/cable,server=on,wait=off",
            "-chardev socket,id=cable-gateway,path=FOLDER/cable,reconnect=1",
            "-chardev null,id=nowhere",
            "-device isa-serial,chardev=nowhere,index=1",
        ],
        pluggable: &[
            Device { name: "host", what: "usb-serial,bus=usb.0,chardev=cable-host,serial=HOST" },
            Device { name: "gateway", what: "usb-serial,bus=usb.0,chardev=cable-gateway,serial=GATEWAY" },
        ],
    },
    Suite {
        name: "arcnet",
        what: "the bus of an arm, by the kernel's ARCNET driver; two arms, each behind a gateway at an ARCNET interface",
        package: "pb3dp-arm-pa10",
        example: "arm_guest",
        has_product: false,
        processor: PLAIN,
        modules: &["arcnet", "arc_rawmode", "tun"],
        modules_by_hand: &["arc_rimi"],
        // Memory that the kernel does not use serves as a card, which the program also reads and writes.
        kernel_arguments: "memmap=1M$0x10000000 iomem=relaxed",
        // A port with the card's interrupt.
        fixed: &["-chardev null,id=nowhere", "-device isa-serial,chardev=nowhere,index=1"],
        pluggable: &[],
    },
    Suite {
        name: "cameras",
        what: "two cameras by V4L2: modes, controls, pairs, damaged images, a camera that is unplugged",
        package: "pb3dp-camera-v4l2",
        example: "camera_guest",
        has_product: false,
        processor: PLAIN,
        modules: &[],
        // The program sets the number of cameras.
        modules_by_hand: &["vivid"],
        // On a busy machine the kernel's check of its timer would fail.
        kernel_arguments: "no_timer_check",
        fixed: &[],
        pluggable: &[],
    },
    RIG,
    Suite { name: "rig-one-device", what: "the same with one camera that delivers both views side by side", ..RIG },
];

/// The rig, with two cameras.
const RIG: Suite = Suite {
    name: "rig",
    what: "`pb3dp run` with configs/rig.toml: two cameras, two emulated arms at serial ports, a camera that is unplugged",
    package: "system-tests",
    example: "rig",
    has_product: true,
    processor: WITH_VECTORS,
    modules: &["xhci_pci", "ftdi_sio"],
    modules_by_hand: &["vivid"],
    kernel_arguments: "no_timer_check",
    // Two adapters at the ends of each of two cables.
    fixed: &[
        "-device qemu-xhci,id=usb",
        "-chardev socket,id=cable-1,path=FOLDER/cable1,server=on,wait=off",
        "-chardev socket,id=cable-far-1,path=FOLDER/cable1,reconnect=1",
        "-chardev socket,id=cable-2,path=FOLDER/cable2,server=on,wait=off",
        "-chardev socket,id=cable-far-2,path=FOLDER/cable2,reconnect=1",
    ],
    pluggable: &[
        Device { name: "arm-1", what: "usb-serial,bus=usb.0,chardev=cable-1,serial=ARM1" },
        Device { name: "far-1", what: "usb-serial,bus=usb.0,chardev=cable-far-1,serial=FAR1" },
        Device { name: "arm-2", what: "usb-serial,bus=usb.0,chardev=cable-2,serial=ARM2" },
        Device { name: "far-2", what: "usb-serial,bus=usb.0,chardev=cable-far-2,serial=FAR2" },
    ],
};
