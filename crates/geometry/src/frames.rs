//! The coordinate frames of the project, as marker types. `docs/frames.md` defines origin and axes of each.

/// A coordinate frame, known at compile time.
pub trait Frame: Copy + Send + Sync + 'static {
    /// The frame's name in files, logs and documents.
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident = $text:literal;)*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, PartialEq, Eq)]
            pub struct $name;
            impl Frame for $name {
                const NAME: &'static str = $text;
            }
        )*
    };
}

frames! {
    /// Fixed to the workcell, z up.
    World = "world";
    /// Base of an arm: z up, x forward.
    Base = "base";
    /// Last link of an arm; z along the last joint's axis, away from the arm.
    Flange = "flange";
    /// Base of the target arm (`tc`) in code that deals with both arms. In such code, [`Base`] is the base of the camera arm.
    TcBase = "tc_base";
    /// Flange of the target arm (`tc`) in code that deals with both arms. In such code, [`Flange`] is the flange of the camera arm.
    TcFlange = "tc_flange";
    /// The hand (end effector), whose pose is controlled; fixed to the flange.
    Hand = "hand";
    /// Left camera: optical centre, x right, y down, z forward.
    CamLeft = "cam_left";
    /// Right camera: optical centre, x right, y down, z forward.
    CamRight = "cam_right";
    /// Left camera after rectification: same centre as `cam_left`, axes rotated so that rows are epipolar lines.
    CamLeftRect = "cam_left_rect";
    /// Right camera after rectification.
    CamRightRect = "cam_right_rect";
    /// The estimated frame on the target, defined by the first stereo pair. Origin: where the ray of the region's centroid meets the
    /// target's plane. z: perpendicular to this plane, away from the cameras.
    Model = "model";
    /// The plane of the visible surface of the target, beside `model`. Origin: where the ray of the origin of `model` in the first left image
    /// meets it. z: perpendicular to it, away from the cameras.
    Surface = "surface";
    /// The object carried by the target arm, as the simulator describes it.
    Target = "target";
    /// On a calibration board: origin at its first corner, x along the rows, y down the columns, z into the board.
    Board = "board";
}
