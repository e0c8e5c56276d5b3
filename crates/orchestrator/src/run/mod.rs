//! `pb3dp run`: cameras, estimation, servo and arms in one loop.

pub mod carrier;
pub mod cell;
pub mod channels;
pub mod commands;
pub mod compared;
pub mod cycles;
pub mod eyes;
pub mod flight;
pub mod interruption;
pub mod journal;
pub mod live;
pub mod lockstep;
pub mod log;
pub mod looking;
pub mod methods;
pub mod moving;
pub mod paced_clock;
pub mod percept;
pub mod permitting;
pub mod recording;
pub mod report;
pub mod strip;
pub mod summary;
pub mod supervision;
pub mod swing;
