//! Motion limits of an arm, as HELLO and HELLO_REPLY state them: the values of host and gateway are compared as the same whole
//! numbers.

use pb3dp_kinematics::EffectiveLimits;

use super::fields::{Fields, Put};
use super::{MessageError, Payload};
use crate::codec::Axis;
use crate::codes::codes;

/// Version of the limits in HELLO and HELLO_REPLY.
pub(super) const LIMITS_VERSION: u8 = 1;

/// Length of the limits in a payload.
pub(super) const LIMITS_LENGTH: usize = Axis::COUNT * 10;

/// Units of speeds (rad/s) and angles (rad): those of the servo controller for speeds.
const PER_RAD: f64 = 5000.0;

/// The largest speed that the servo controller can be told, in the negative direction.
const SPEED_MAX: u16 = i16::MIN.unsigned_abs();

/// Units of accelerations, per rad/s^2.
const PER_RAD_PER_S2: f64 = 100.0;

/// Units of jerks, per rad/s^3.
const PER_RAD_PER_S3: f64 = 5.0;

codes! {
    /// A limited quantity of an axis.
    MotionQuantity {
        /// Speed.
        Speed = 1, "speed";
        /// Acceleration.
        Acceleration = 2, "acceleration";
        /// Jerk.
        Jerk = 3, "jerk";
        /// Upper end of the range.
        UpperEnd = 4, "upper end of the range";
        /// Lower end of the range.
        LowerEnd = 5, "lower end of the range";
    }
}

/// Limits of one axis in units of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisMotionLimits {
    /// Largest speed, 0.0002 rad/s: 1 to 32768.
    pub speed: u16,
    /// Largest acceleration, 0.01 rad/s^2: above 0.
    pub acceleration: u16,
    /// Largest jerk, 0.2 rad/s^3: above 0.
    pub jerk: u16,
    /// Lower end of the range, 0.0002 rad.
    pub lower: i16,
    /// Upper end of the range, 0.0002 rad: above the lower end.
    pub upper: i16,
}

/// Limits of one axis in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisMotion {
    /// Largest speed, rad/s.
    pub speed_max_rad_per_s: f64,
    /// Largest acceleration, rad/s^2.
    pub acceleration_max_rad_per_s2: f64,
    /// Largest jerk, rad/s^3.
    pub jerk_max_rad_per_s3: f64,
    /// Lower and upper end of the range, rad.
    pub range_rad: [f64; 2],
}

/// Motion limits of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotionLimits {
    /// From the base on.
    pub axes: [AxisMotionLimits; Axis::COUNT],
}

/// Limits of a host: what its commands keep, and what its setup allows a gateway to allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostLimits {
    /// The limits of all commands of this host: stated in HELLO.
    pub asked: MotionLimits,
    /// A gateway that allows more is refused.
    pub allowed: MotionLimits,
}

/// A limit that the protocol cannot state.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{axis}: a limit of {got} for the {quantity} is out of range: give {least} to {most} {unit}", unit = .quantity.unit())]
pub struct LimitOutOfRange {
    /// Which axis.
    pub axis: Axis,
    /// Which quantity.
    pub quantity: MotionQuantity,
    /// The given value, SI.
    pub got: f64,
    /// The smallest possible value, SI.
    pub least: f64,
    /// The largest possible value, SI.
    pub most: f64,
}

/// A limit on one side that is wider than on the other side: values in units of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WiderLimit {
    /// Which axis.
    pub axis: Axis,
    /// Which quantity.
    pub quantity: MotionQuantity,
    /// The wider limit.
    pub wider: i32,
    /// The limit that it exceeds.
    pub limit: i32,
}

impl MotionQuantity {
    /// Unit for messages; angles in degrees.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Speed => "rad/s",
            Self::Acceleration => "rad/s^2",
            Self::Jerk => "rad/s^3",
            Self::UpperEnd | Self::LowerEnd => "rad",
        }
    }

    /// Units of the protocol per SI unit.
    fn scale(self) -> f64 {
        match self {
            Self::Speed | Self::UpperEnd | Self::LowerEnd => PER_RAD,
            Self::Acceleration => PER_RAD_PER_S2,
            Self::Jerk => PER_RAD_PER_S3,
        }
    }

    /// A value in SI units.
    pub fn to_si(self, value: i32) -> f64 {
        f64::from(value) / self.scale()
    }

    /// Key of this quantity in the file of `pb3dp gateway`.
    pub fn key(self) -> &'static str {
        match self {
            Self::Speed => "speed_max_rad_per_s",
            Self::Acceleration => "acceleration_max_rad_per_s2",
            Self::Jerk => "jerk_max_rad_per_s3",
            Self::UpperEnd => "upper_deg",
            Self::LowerEnd => "lower_deg",
        }
    }

    /// A value of the protocol with its unit, angles in degrees.
    pub fn text(self, value: i32) -> String {
        match self {
            Self::UpperEnd | Self::LowerEnd => format!("{:.2} degrees", self.to_si(value).to_degrees()),
            _ => format!("{} {}", self.to_si(value), self.unit()),
        }
    }
}

impl AxisMotionLimits {
    /// The limits of `axis`, rounded to the nearest units of the protocol.
    ///
    /// # Errors
    /// If a value has no number in the protocol, is not positive, or the range is empty.
    pub fn new(axis: Axis, motion: &AxisMotion) -> Result<Self, LimitOutOfRange> {
        let whole = |quantity: MotionQuantity, si: f64, least: f64, most: f64| {
            let units = (si * quantity.scale()).round();
            // False for NaN; after it the casts are exact.
            if units >= least && units <= most {
                return Ok(units);
            }
            let [least, most] = [least, most].map(|units| units / quantity.scale());
            Err(LimitOutOfRange { axis, quantity, got: si, least, most })
        };
        let (largest, angle_max) = (f64::from(u16::MAX), f64::from(i16::MAX));
        let [lower_rad, upper_rad] = motion.range_rad;
        let lower = whole(MotionQuantity::LowerEnd, lower_rad, -angle_max, angle_max - 1.0)?;
        Ok(Self {
            speed: whole(MotionQuantity::Speed, motion.speed_max_rad_per_s, 1.0, f64::from(SPEED_MAX))? as u16,
            acceleration: whole(MotionQuantity::Acceleration, motion.acceleration_max_rad_per_s2, 1.0, largest)? as u16,
            jerk: whole(MotionQuantity::Jerk, motion.jerk_max_rad_per_s3, 1.0, largest)? as u16,
            lower: lower as i16,
            upper: whole(MotionQuantity::UpperEnd, upper_rad, lower + 1.0, angle_max)? as i16,
        })
    }

    /// The limits in SI units.
    pub fn to_si(&self) -> AxisMotion {
        let si = |quantity: MotionQuantity| quantity.to_si(self.of(quantity));
        AxisMotion {
            speed_max_rad_per_s: si(MotionQuantity::Speed),
            acceleration_max_rad_per_s2: si(MotionQuantity::Acceleration),
            jerk_max_rad_per_s3: si(MotionQuantity::Jerk),
            range_rad: [si(MotionQuantity::LowerEnd), si(MotionQuantity::UpperEnd)],
        }
    }

    /// One value.
    pub fn of(&self, quantity: MotionQuantity) -> i32 {
        match quantity {
            MotionQuantity::Speed => i32::from(self.speed),
            MotionQuantity::Acceleration => i32::from(self.acceleration),
            MotionQuantity::Jerk => i32::from(self.jerk),
            MotionQuantity::UpperEnd => i32::from(self.upper),
            MotionQuantity::LowerEnd => i32::from(self.lower),
        }
    }
}

impl MotionLimits {
    /// The widest limits that the protocol can state: for tests of everything but limits.
    pub const WIDEST: Self = Self {
        axes: [AxisMotionLimits {
            speed: SPEED_MAX,
            acceleration: u16::MAX,
            jerk: u16::MAX,
            lower: -i16::MAX,
            upper: i16::MAX,
        }; Axis::COUNT],
    };

    /// Limits of all axes in SI units.
    ///
    /// # Errors
    /// As [`AxisMotionLimits::new`], for the first such axis.
    pub fn new(motions: &[AxisMotion; Axis::COUNT]) -> Result<Self, LimitOutOfRange> {
        let mut axes = Self::WIDEST.axes;
        for (axis, motion) in Axis::ALL.iter().zip(motions) {
            axes[axis.index()] = AxisMotionLimits::new(*axis, motion)?;
        }
        Ok(Self { axes })
    }

    /// The first limit that is wider here than in `other`.
    pub fn wider_than(&self, other: &Self) -> Option<WiderLimit> {
        for (axis, (own, other)) in Axis::ALL.into_iter().zip(self.axes.iter().zip(&other.axes)) {
            for &quantity in MotionQuantity::LISTED {
                let (wider, limit) = (own.of(quantity), other.of(quantity));
                let is_wider = if quantity == MotionQuantity::LowerEnd { wider < limit } else { wider > limit };
                if is_wider {
                    return Some(WiderLimit { axis, quantity, wider, limit });
                }
            }
        }
        None
    }

    pub(super) fn encode(&self, payload: &mut Payload) {
        for axis in &self.axes {
            payload.put_u16(axis.speed);
            payload.put_u16(axis.acceleration);
            payload.put_u16(axis.jerk);
            payload.put_u16(axis.lower.cast_unsigned());
            payload.put_u16(axis.upper.cast_unsigned());
        }
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, MessageError> {
        let mut limits = Self::WIDEST;
        for axis in &mut limits.axes {
            let [speed, acceleration, jerk] = [fields.u16(), fields.u16(), fields.u16()];
            let [lower, upper] = [fields.u16().cast_signed(), fields.u16().cast_signed()];
            for (field, value, most) in [
                ("speed limit", speed, SPEED_MAX),
                ("acceleration limit", acceleration, u16::MAX),
                ("jerk limit", jerk, u16::MAX),
            ] {
                if value == 0 || value > most {
                    return Err(fields.no_meaning(field, i64::from(value)));
                }
            }
            if lower >= upper || lower == i16::MIN {
                return Err(fields.no_meaning("lower end of the range", i64::from(lower)));
            }
            *axis = AxisMotionLimits { speed, acceleration, jerk, lower, upper };
        }
        Ok(limits)
    }
}

impl HostLimits {
    /// For tests of everything but limits.
    pub const WIDEST: Self = Self { asked: MotionLimits::WIDEST, allowed: MotionLimits::WIDEST };

    /// The limits of a host with this setup. Its commands keep the operating range and the scaled speeds; a gateway may allow the
    /// servo range and the speeds of the drives. Acceleration and jerk are the same.
    ///
    /// # Errors
    /// As [`AxisMotionLimits::new`].
    pub fn of_setup(limits: &EffectiveLimits) -> Result<Self, LimitOutOfRange> {
        let within = |range: &pb3dp_kinematics::JointLimits| {
            MotionLimits::new(&std::array::from_fn(|joint| AxisMotion {
                speed_max_rad_per_s: range.velocity_max_rad_per_s()[joint],
                acceleration_max_rad_per_s2: limits.acceleration_max_rad_per_s2()[joint],
                jerk_max_rad_per_s3: limits.jerk_max_rad_per_s3()[joint],
                range_rad: [range.position_min_rad()[joint], range.position_max_rad()[joint]],
            }))
        };
        Ok(Self { asked: within(limits.operating())?, allowed: within(limits.servo())? })
    }
}

impl WiderLimit {
    /// As the detail of REJECT: axis, quantity, the gateway's limit.
    pub fn detail(&self) -> u32 {
        // Every value of a limit has 16 bits.
        let value = (self.limit & 0xFFFF).cast_unsigned();
        u32::from(self.axis.number()) | u32::from(self.quantity.code()) << 8 | value << 16
    }

    /// From the detail of REJECT: the wider limit is that of `asked`.
    pub fn from_detail(detail: u32, asked: &MotionLimits) -> Option<Self> {
        let [axis, quantity, low, high] = detail.to_le_bytes();
        let axis = Axis::from_number(u16::from(axis)).ok()?;
        let quantity = MotionQuantity::from_code(quantity)?;
        let value = u16::from_le_bytes([low, high]);
        let limit = match quantity {
            MotionQuantity::UpperEnd | MotionQuantity::LowerEnd => i32::from(value.cast_signed()),
            _ => i32::from(value),
        };
        Some(Self { axis, quantity, wider: asked.axes[axis.index()].of(quantity), limit })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion() -> AxisMotion {
        AxisMotion {
            speed_max_rad_per_s: 0.25,
            acceleration_max_rad_per_s2: 2.0,
            jerk_max_rad_per_s3: 80.0,
            range_rad: [-1.5882, 1.5882],
        }
    }

    #[test]
    fn limits_keep_their_values_to_half_a_unit() {
        let axis = AxisMotionLimits::new(Axis::ALL[1], &motion()).unwrap();
        let expected = AxisMotionLimits { speed: 1250, acceleration: 200, jerk: 400, lower: -7941, upper: 7941 };
        assert_eq!((axis, axis.to_si()), (expected, motion()));
    }

    #[test]
    fn values_without_a_number_are_refused() {
        type Change = fn(&mut AxisMotion);
        let changes: [(MotionQuantity, Change, &str); 8] = [
            (MotionQuantity::Speed, |m| m.speed_max_rad_per_s = 0.0, "give 0.0002 to 6.5536 rad/s"),
            (MotionQuantity::Speed, |m| m.speed_max_rad_per_s = 6.5538, "6.5538"),
            (MotionQuantity::Acceleration, |m| m.acceleration_max_rad_per_s2 = f64::NAN, "0.01 to 655.35 rad/s^2"),
            (MotionQuantity::Jerk, |m| m.jerk_max_rad_per_s3 = f64::INFINITY, "0.2 to 13107 rad/s^3"),
            (MotionQuantity::Jerk, |m| m.jerk_max_rad_per_s3 = -1.0, "-1"),
            (MotionQuantity::LowerEnd, |m| m.range_rad[0] = -6.6, "-6.6"),
            (MotionQuantity::UpperEnd, |m| m.range_rad[1] = 6.6, "6.6"),
            (MotionQuantity::UpperEnd, |m| m.range_rad[1] = -1.5882, "-1.588"),
        ];
        for (quantity, change, text) in changes {
            let mut bad = motion();
            change(&mut bad);
            let error = AxisMotionLimits::new(Axis::ALL[1], &bad).unwrap_err();
            assert_eq!((error.axis, error.quantity), (Axis::ALL[1], quantity));
            assert!(error.to_string().contains(text), "{text} not in {error}");
        }
    }

    #[test]
    fn one_unit_more_is_wider_and_survives_the_detail_of_a_refusal() {
        let limits = MotionLimits::new(&[motion(); Axis::COUNT]).unwrap();
        assert_eq!(limits.wider_than(&limits), None);
        for (at, &quantity) in MotionQuantity::LISTED.iter().enumerate() {
            let mut wider = limits;
            let axis = &mut wider.axes[at + 2];
            match quantity {
                MotionQuantity::Speed => axis.speed += 1,
                MotionQuantity::Acceleration => axis.acceleration += 1,
                MotionQuantity::Jerk => axis.jerk += 1,
                MotionQuantity::UpperEnd => axis.upper += 1,
                MotionQuantity::LowerEnd => axis.lower -= 1,
            }
            let found = wider.wider_than(&limits).unwrap();
            assert_eq!((found.axis, found.quantity), (Axis::ALL[at + 2], quantity));
            assert_eq!((found.wider - found.limit).abs(), 1, "{found:?}");
            assert_eq!(limits.wider_than(&wider), None, "narrower: {quantity}");
            assert_eq!(WiderLimit::from_detail(found.detail(), &wider), Some(found));
        }
        assert_eq!(WiderLimit::from_detail(0x0100_0108, &limits), None, "axis 8");
        assert_eq!(WiderLimit::from_detail(0x0100_0601, &limits), None, "quantity 6");
    }
}
