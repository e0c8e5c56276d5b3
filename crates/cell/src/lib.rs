//! One running cell: cameras, estimation, servo and arms in one loop, led by an operator's commands, with a report.
//!
//! What runs comes from wiring as [`parts`]; nothing here names a backend.

pub mod both_arms;
pub mod capturing;
pub mod carrier;
pub mod cell;
pub mod channels;
pub mod commands;
pub mod compared;
pub mod console;
pub mod cpu_time;
pub mod cycles;
pub mod drift;
pub mod experiment;
pub mod eyes;
pub mod flight;
pub mod follower;
pub mod halves;
pub mod handover;
pub mod interruption;
pub mod journal;
pub mod live;
pub mod lockstep;
pub mod log;
pub mod looking;
mod losses;
pub mod methods;
pub mod moving;
pub mod noting;
pub mod operator;
pub mod paced_clock;
pub mod parts;
pub mod percept;
pub mod permitting;
pub mod picture;
pub mod picture_quality;
pub mod plan;
pub mod recording;
pub mod report;
pub mod stillness;
pub mod strip;
pub mod summary;
pub mod supervision;
pub mod swing;
pub mod visiting;
