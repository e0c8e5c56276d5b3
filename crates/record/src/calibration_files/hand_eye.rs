//! Our TOML file of a hand-eye calibration: pose of the left camera on the flange, and pose of the board.
//!
//! The layout follows the file of a stereo calibration: table names give frames, keys give units, and numbers are preserved bit
//! by bit. `base` and `flange` belong to the arm `vs`, which carries the cameras. The base is called `vs_base` where the base of
//! the arm `tc` appears as well.
//! that of the arm `tc` is named beside it.

use pb3dp_geometry::frames::{Base, Board, CamLeft, Flange, TcBase, TcFlange};
use pb3dp_geometry::{Frame, Pose};

use super::document::Node;
use super::error::CalibrationFileError;
use super::judged::{self, Judgement};
use super::pose as poses;

/// Required value of the key `format`.
const FORMAT: &str = "pb3dp hand-eye calibration 1";
/// Maximum translation on a hand, metres; longer ones are input mistakes.
const ON_HAND_MAX_M: f64 = 2.0;
/// Maximum translation in a workcell, metres; longer ones are input mistakes.
const IN_CELL_MAX_M: f64 = 20.0;

/// A hand-eye calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEye {
    /// The pose of the left camera on the flange of the arm that carries it.
    pub flange_from_cam_left: Pose<Flange, CamLeft>,
    /// Pose of the board.
    pub board: BoardPlace,
    /// Origin and quality of the calibration; the cameras are those of the stereo calibration that was used.
    pub judgement: Judgement,
}

/// Where the board of a hand-eye calibration was mounted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardPlace {
    /// Stationary in the room.
    Room {
        /// The board in the base of the arm that carries the cameras.
        base_from_board: Pose<Base, Board>,
    },
    /// On the flange of the other arm.
    Carried {
        /// The base of the other arm in the base of the arm that carries the cameras.
        vs_base_from_tc_base: Pose<Base, TcBase>,
        /// The board on the other arm's flange.
        tc_flange_from_board: Pose<TcFlange, Board>,
    },
}

pub(super) fn read(root: &Node<'_>) -> Result<HandEye, CalibrationFileError> {
    let format = root.get("format")?;
    if format.text()? != FORMAT {
        return Err(format.refuse(format!("is {:?}, it must be {FORMAT:?}", format.text()?)));
    }
    let carried = root.find("vs_base_from_tc_base").is_some() || root.find("tc_flange_from_board").is_some();
    let board = if carried {
        BoardPlace::Carried {
            vs_base_from_tc_base: pose(&root.get("vs_base_from_tc_base")?, IN_CELL_MAX_M)?,
            tc_flange_from_board: pose(&root.get("tc_flange_from_board")?, ON_HAND_MAX_M)?,
        }
    } else {
        BoardPlace::Room { base_from_board: pose(&root.get("base_from_board")?, IN_CELL_MAX_M)? }
    };
    let flange_from_cam_left = pose(&root.get("flange_from_cam_left")?, ON_HAND_MAX_M)?;
    Ok(HandEye { flange_from_cam_left, board, judgement: judged::judgement(root)? })
}

/// A pose whose frames are given by the name of its table.
fn pose<To: Frame, From: Frame>(node: &Node<'_>, length_max_m: f64) -> Result<Pose<To, From>, CalibrationFileError> {
    let pose = poses::read(node)?;
    let length_m = pose.translation_m().norm();
    if length_m > length_max_m {
        let reason = format!("has length {length_m} m, at most {length_max_m} m is allowed; check the unit of length");
        return Err(node.get("translation_m")?.refuse(reason));
    }
    Ok(pose)
}

/// The text of the file.
pub(super) fn write(hand_eye: &HandEye) -> Result<String, CalibrationFileError> {
    let HandEye { flange_from_cam_left, board, judgement } = hand_eye;
    judged::check_finite(judgement)?;
    let mut file = judged::write_head(FORMAT, judgement);
    for (side, identity) in ["left", "right"].into_iter().zip(&judgement.cameras) {
        file += &judged::write_identity(side, identity);
    }
    file += "\n# a_from_b maps coordinates in b to a. cam_left: x right, y down, z forward.\n";
    file += &table("flange_from_cam_left", flange_from_cam_left);
    match board {
        BoardPlace::Room { base_from_board } => file += &table("base_from_board", base_from_board),
        BoardPlace::Carried { vs_base_from_tc_base, tc_flange_from_board } => {
            file += &table("vs_base_from_tc_base", vs_base_from_tc_base);
            file += &table("tc_flange_from_board", tc_flange_from_board);
        }
    }
    Ok(file + &judged::write_worth(judgement))
}

fn table<To: Frame, From: Frame>(name: &str, pose: &Pose<To, From>) -> String {
    format!("\n[{name}]\n{}", poses::write(pose))
}
