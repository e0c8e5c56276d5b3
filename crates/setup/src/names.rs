//! Names of wire formats and geometries, in files and on the command line.

use clap::ValueEnum;
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::Geometry;
use serde::Deserialize;

/// Wire formats: `A` and `B` in files, `a` and `b` on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ValueEnum)]
pub enum FormatName {
    /// Format A.
    A,
    /// Format B.
    B,
}

/// Geometries: `first-generation` in files, `first` on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum GeometryName {
    /// Unknown.
    Unknown,
    /// 315, 450, 500 and 80 mm.
    #[value(name = "first")]
    FirstGeneration,
    /// 317, 450, 480 and 70 mm.
    #[value(name = "second")]
    SecondGeneration,
}

impl From<FormatName> for WireFormat {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::A => Self::LittleEndian5x8,
            FormatName::B => Self::BigEndian6x10,
        }
    }
}

impl From<GeometryName> for Geometry {
    fn from(name: GeometryName) -> Self {
        match name {
            GeometryName::Unknown => Self::Unknown,
            GeometryName::FirstGeneration => Self::FirstGeneration,
            GeometryName::SecondGeneration => Self::SecondGeneration,
        }
    }
}
