//! Which tests run in an emulated computer, and what that computer has.

/// A set of tests in one emulated computer.
pub struct Suite {
    /// On the command line, and what the guest's program is told.
    pub name: &'static str,
    /// For the reader.
    pub what: &'static str,
    /// Where the guest's program is.
    pub package: &'static str,
    /// Its name: an example of that package.
    pub example: &'static str,
    /// Modules that are loaded before the program starts.
    pub modules: &'static [&'static str],
    /// Modules that the program loads itself.
    pub modules_by_hand: &'static [&'static str],
    /// Of the kernel.
    pub kernel_arguments: &'static str,
    /// Options of QEMU; FOLDER is where its sockets may be.
    pub fixed: &'static [&'static str],
    /// Devices that the program may have pulled out.
    pub pluggable: &'static [Device],
}

/// A device that can be pulled out.
pub struct Device {
    pub name: &'static str,
    /// As on QEMU's command line.
    pub what: &'static str,
}

/// All of them.
pub const SUITES: [Suite; 3] = [
    Suite {
        name: "serial",
        what: "serial ports of an arm: USB adapters, a 16550, a cable that is pulled",
        package: "pb3dp-arm-pa10",
        example: "guest",
        modules: &["xhci_pci", "ftdi_sio", "configfs", "dummy_hcd", "usb_f_acm", "cdc_acm"],
        modules_by_hand: &[],
        kernel_arguments: "",
        // Two adapters at the ends of one cable, and a built-in port that leads nowhere.
        fixed: &[
            "-device",
            "qemu-xhci,id=usb",
            "-chardev",
            "socket,id=cable-host,path=FOLDER/cable,server=on,wait=off",
            "-chardev",
            "socket,id=cable-gateway,path=FOLDER/cable,reconnect=1",
            "-chardev",
            "null,id=nowhere",
            "-device",
            "isa-serial,chardev=nowhere,index=1",
        ],
        pluggable: &[
            Device { name: "host", what: "usb-serial,bus=usb.0,chardev=cable-host,serial=HOST" },
            Device { name: "gateway", what: "usb-serial,bus=usb.0,chardev=cable-gateway,serial=GATEWAY" },
        ],
    },
    Suite {
        name: "arcnet",
        what: "the bus of an arm, by the kernel's ARCNET driver",
        package: "pb3dp-arm-pa10",
        example: "guest",
        modules: &["arcnet", "arc_rawmode"],
        modules_by_hand: &["arc_rimi"],
        // A part of the memory that the kernel does not use stands for a card, which the program reads and writes as well.
        kernel_arguments: "memmap=1M$0x10000000 iomem=relaxed",
        // A port whose interrupt is the card's.
        fixed: &["-chardev", "null,id=nowhere", "-device", "isa-serial,chardev=nowhere,index=1"],
        pluggable: &[],
    },
    Suite {
        name: "cameras",
        what: "two cameras by V4L2: modes, controls, pairs, what is damaged, a camera that is pulled",
        package: "pb3dp-camera-v4l2",
        example: "guest",
        modules: &[],
        // The program says how many cameras there are.
        modules_by_hand: &["vivid"],
        // A kernel that tries its timer on a busy machine takes it for broken.
        kernel_arguments: "no_timer_check",
        fixed: &[],
        pluggable: &[],
    },
];
