//! The subcommands, one file each: arguments in, exit code out.

pub mod attendance;
pub mod cameras;
pub mod completions;
pub mod config;
pub mod doctor;
pub mod estimate;
pub mod explain;
pub mod extract;
pub mod generate;
pub mod identify;
mod output_file;
pub mod overlay_folder;
pub mod pair;
pub mod panel;
mod panel_of_run;
pub mod recover;
pub mod replay;
pub mod report;
mod result_folder;
pub mod rig;
pub mod run;
pub mod track;
