//! The ROS 2 messages in recordings, with their definitions.
//!
//! Names and fields are those of the ROS 2 packages `std_msgs`, `sensor_msgs`, `geometry_msgs`, `tf2_msgs`, `diagnostic_msgs` and
//! `rcl_interfaces` (ROS 2 Jazzy); lengths are in metres, angles in radians, as in ROS REP 103.

use pb3dp_geometry::MonotonicTime;

use crate::cdr::{Bytes, CdrError, CdrReader, CdrValue, CdrWriter};

/// A message that has a topic of its own.
pub trait Message: CdrValue {
    /// Its name in ROS 2, `package/msg/Name`.
    fn name() -> String {
        Self::ros_type().replacen('/', "/msg/", 1)
    }

    /// Its definition with those of all messages in it, in the format `ros2msg` of MCAP.
    fn definition() -> String {
        let mut definitions = Vec::new();
        Self::define(&mut definitions);
        let mut text = String::new();
        for (index, (name, fields)) in definitions.iter().enumerate() {
            if index > 0 {
                text += &format!("{}\nMSG: {name}\n", "=".repeat(80));
            }
            text += fields;
        }
        text
    }
}

macro_rules! message {
    ($(#[$doc:meta])* $name:ident = $ros:literal { $($(#[$field_doc:meta])* $field:ident: $type:ty,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)+
        }

        impl CdrValue for $name {
            fn ros_type() -> String {
                $ros.to_owned()
            }

            fn define(definitions: &mut Vec<(&'static str, String)>) {
                if definitions.iter().any(|(name, _)| *name == $ros) {
                    return;
                }
                let fields = [$(format!("{} {}\n", <$type>::ros_type(), stringify!($field))),+];
                definitions.push(($ros, fields.concat()));
                $(<$type>::define(definitions);)+
            }

            fn write(&self, writer: &mut CdrWriter) {
                $(self.$field.write(writer);)+
            }

            fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                Ok(Self { $($field: <$type>::read(reader)?,)+ })
            }
        }

        impl Message for $name {}
    };
}

pub(crate) use message;

message! {
    /// A time since 1970, or since the begin of a simulation.
    #[derive(Copy, Eq, Default)]
    Time = "builtin_interfaces/Time" {
        /// Whole seconds.
        sec: i32,
        /// The rest, nanoseconds.
        nanosec: u32,
    }
}

impl Time {
    const NANOS: u64 = 1_000_000_000;

    /// Nanoseconds since the origin. Times before the origin are 0.
    pub fn nanos(self) -> u64 {
        u64::try_from(self.sec).unwrap_or(0) * Self::NANOS + u64::from(self.nanosec)
    }

    /// The time as the clock of a camera.
    pub fn monotonic(self) -> MonotonicTime {
        MonotonicTime::from_nanos(self.nanos())
    }
}

impl From<MonotonicTime> for Time {
    /// Times after the year 2038 are its end: ROS 2 has no later ones.
    fn from(time: MonotonicTime) -> Self {
        let nanos = time.as_nanos();
        Self { sec: i32::try_from(nanos / Self::NANOS).unwrap_or(i32::MAX), nanosec: (nanos % Self::NANOS) as u32 }
    }
}

message! {
    /// Time and frame of a message.
    #[derive(Eq, Default)]
    Header = "std_msgs/Header" {
        /// Time of the measurement.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    }
}

message! {
    /// A text.
    #[derive(Eq)]
    Text = "std_msgs/String" {
        /// The text.
        data: String,
    }
}

message! {
    /// An image without compression.
    #[derive(Eq)]
    Image = "sensor_msgs/Image" {
        /// Middle of the exposure; the camera.
        header: Header,
        /// Number of rows.
        height: u32,
        /// Number of columns.
        width: u32,
        /// Meaning of the bytes, such as `rgb8` or `mono16`.
        encoding: String,
        /// 1 if numbers of several bytes begin with the most significant one.
        is_bigendian: u8,
        /// Bytes of a row.
        step: u32,
        /// The rows.
        data: Bytes,
    }
}

message! {
    /// An image in the format of an image file.
    #[derive(Eq)]
    CompressedImage = "sensor_msgs/CompressedImage" {
        /// Middle of the exposure; the camera.
        header: Header,
        /// The format, such as `jpeg`.
        format: String,
        /// The file.
        data: Bytes,
    }
}

message! {
    /// The part of the sensor that an image shows.
    #[derive(Eq, Default)]
    RegionOfInterest = "sensor_msgs/RegionOfInterest" {
        /// First column.
        x_offset: u32,
        /// First row.
        y_offset: u32,
        /// Number of rows; 0: the whole sensor.
        height: u32,
        /// Number of columns; 0: the whole sensor.
        width: u32,
        /// Whether the part is one of the rectified image.
        do_rectify: bool,
    }
}

message! {
    /// Calibration of a camera, and of the stereo pair in `p`.
    CameraInfo = "sensor_msgs/CameraInfo" {
        /// Middle of the exposure; the camera.
        header: Header,
        /// Number of rows.
        height: u32,
        /// Number of columns.
        width: u32,
        /// `plumb_bob`, `rational_polynomial` or `equidistant`.
        distortion_model: String,
        /// Coefficients of the distortion.
        d: Vec<f64>,
        /// Camera matrix, row by row, pixels.
        k: [f64; 9],
        /// Rotation from this camera to its rectified frame, row by row.
        r: [f64; 9],
        /// Projection of the rectified camera, row by row; `p[3] = -fx baseline` for the right one, pixels times metres.
        p: [f64; 12],
        /// Columns of the sensor per column of the image; 0 is 1.
        binning_x: u32,
        /// Rows of the sensor per row of the image; 0 is 1.
        binning_y: u32,
        /// The part of the sensor.
        roi: RegionOfInterest,
    }
}

message! {
    /// Joints of an arm, measured or commanded.
    JointState = "sensor_msgs/JointState" {
        /// Time of the measurement or command.
        header: Header,
        /// Names of the joints.
        name: Vec<String>,
        /// Angles, rad.
        position: Vec<f64>,
        /// Velocities, rad/s.
        velocity: Vec<f64>,
        /// Torques, N m.
        effort: Vec<f64>,
    }
}

message! {
    /// A point, m.
    #[derive(Copy)]
    Point = "geometry_msgs/Point" {
        /// x, m.
        x: f64,
        /// y, m.
        y: f64,
        /// z, m.
        z: f64,
    }
}

message! {
    /// A vector, m.
    #[derive(Copy)]
    Vector3 = "geometry_msgs/Vector3" {
        /// x, m.
        x: f64,
        /// y, m.
        y: f64,
        /// z, m.
        z: f64,
    }
}

message! {
    /// A unit quaternion.
    #[derive(Copy)]
    Quaternion = "geometry_msgs/Quaternion" {
        /// Component of i.
        x: f64,
        /// Component of j.
        y: f64,
        /// Component of k.
        z: f64,
        /// Real part.
        w: f64,
    }
}

message! {
    /// Position and orientation.
    #[derive(Copy)]
    RosPose = "geometry_msgs/Pose" {
        /// Position, m.
        position: Point,
        /// Orientation.
        orientation: Quaternion,
    }
}

message! {
    /// A pose at a time.
    PoseStamped = "geometry_msgs/PoseStamped" {
        /// Time, and the frame in which the pose is.
        header: Header,
        /// The pose.
        pose: RosPose,
    }
}

message! {
    /// A pose with its covariance.
    PoseWithCovariance = "geometry_msgs/PoseWithCovariance" {
        /// The pose.
        pose: RosPose,
        /// Covariance, row by row: x, y, z in m, then rotations about these fixed axes in rad.
        covariance: [f64; 36],
    }
}

message! {
    /// A pose with its covariance at a time.
    PoseWithCovarianceStamped = "geometry_msgs/PoseWithCovarianceStamped" {
        /// Time, and the frame in which the pose is.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! {
    /// Rotation and translation.
    #[derive(Copy)]
    Transform = "geometry_msgs/Transform" {
        /// Translation, m.
        translation: Vector3,
        /// Rotation.
        rotation: Quaternion,
    }
}

message! {
    /// Pose of a frame in another one.
    TransformStamped = "geometry_msgs/TransformStamped" {
        /// Time, and the parent frame.
        header: Header,
        /// The frame.
        child_frame_id: String,
        /// Its pose in the parent frame.
        transform: Transform,
    }
}

message! {
    /// Poses of frames.
    Transforms = "tf2_msgs/TFMessage" {
        /// The poses.
        transforms: Vec<TransformStamped>,
    }
}

message! {
    /// A point of a polygon.
    #[derive(Copy)]
    Point32 = "geometry_msgs/Point32" {
        /// x.
        x: f32,
        /// y.
        y: f32,
        /// z.
        z: f32,
    }
}

message! {
    /// A polygon.
    Polygon = "geometry_msgs/Polygon" {
        /// Its corners.
        points: Vec<Point32>,
    }
}

message! {
    /// A polygon at a time.
    PolygonStamped = "geometry_msgs/PolygonStamped" {
        /// Time and frame.
        header: Header,
        /// The polygon.
        polygon: Polygon,
    }
}

message! {
    /// A named text.
    #[derive(Eq)]
    KeyValue = "diagnostic_msgs/KeyValue" {
        /// Name.
        key: String,
        /// Text.
        value: String,
    }
}

message! {
    /// State of a part.
    #[derive(Eq)]
    DiagnosticStatus = "diagnostic_msgs/DiagnosticStatus" {
        /// 0 sound, 1 warning, 2 error, 3 no news.
        level: Level,
        /// The part.
        name: String,
        /// The state, and why.
        message: String,
        /// The hardware.
        hardware_id: String,
        /// Details.
        values: Vec<KeyValue>,
    }
}

/// A byte of a state: `byte` in ROS 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level(pub u8);

impl CdrValue for Level {
    fn ros_type() -> String {
        "byte".to_owned()
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.0.write(writer);
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        u8::read(reader).map(Self)
    }
}

message! {
    /// States of parts.
    #[derive(Eq)]
    Diagnostics = "diagnostic_msgs/DiagnosticArray" {
        /// Time.
        header: Header,
        /// The states.
        status: Vec<DiagnosticStatus>,
    }
}

message! {
    /// A line of a log.
    #[derive(Eq)]
    LogLine = "rcl_interfaces/Log" {
        /// Time.
        stamp: Time,
        /// 10 debug, 20 info, 30 warning, 40 error, 50 fatal.
        level: u8,
        /// Name of its source.
        name: String,
        /// The line.
        msg: String,
        /// Source file.
        file: String,
        /// Function.
        function: String,
        /// Line of the source file.
        line: u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::{from_bytes, to_bytes};

    #[test]
    fn definitions_name_every_message_once() {
        assert_eq!(Image::name(), "sensor_msgs/msg/Image");
        let separator = "=".repeat(80);
        assert_eq!(
            Image::definition(),
            format!(
                "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n\
                 {separator}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
                 {separator}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
            )
        );
        let definition = Transforms::definition();
        assert_eq!(definition.matches("MSG: std_msgs/Header\n").count(), 1);
        assert!(definition.starts_with("geometry_msgs/TransformStamped[] transforms\n"));
        assert!(CameraInfo::definition().contains("float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n"));
    }

    #[test]
    fn messages_come_back() {
        let header = Header { stamp: MonotonicTime::from_nanos(1_234_567_890_123).into(), frame_id: "cam".to_owned() };
        assert_eq!((header.stamp.sec, header.stamp.nanosec), (1234, 567_890_123));
        assert_eq!(header.stamp.monotonic(), MonotonicTime::from_nanos(1_234_567_890_123));
        let info = CameraInfo {
            header,
            height: 3,
            width: 4,
            distortion_model: "plumb_bob".to_owned(),
            d: vec![0.1, -0.2, 0.0, 0.0, 0.05],
            k: std::array::from_fn(|i| i as f64),
            r: std::array::from_fn(|i| -(i as f64)),
            p: std::array::from_fn(|i| 0.5 * i as f64),
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest { do_rectify: true, ..RegionOfInterest::default() },
        };
        assert_eq!(from_bytes::<CameraInfo>(&to_bytes(&info)).unwrap(), info);
    }
}
