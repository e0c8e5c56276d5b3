//! Reads the elements of a robot description (URDF) that a chain needs. All other elements and attributes are ignored.
//!
//! Defaults follow the URDF specification (wiki.ros.org/urdf/XML/joint); those of limits differ from version 1.2 on.

use roxmltree::{Document, Node, ParsingOptions};

use crate::chain_error::ChainError;

/// Largest number of elements, texts and comments in a description. Chosen: the arms in `configs/robots/` have fewer than 300,
/// and a tree of this size takes less than 20 MB.
const NODES_MAX: u32 = 100_000;

/// Longest part of an attribute that a message repeats, in characters.
const SHOWN_MAX: usize = 60;

/// A robot, as described.
pub(crate) struct Robot {
    pub name: String,
    /// Names of the links, in the order of the file.
    pub links: Vec<String>,
    pub joints: Vec<Joint>,
}

/// A joint, as described. Numbers may be NaN or infinite.
pub(crate) struct Joint {
    pub name: String,
    /// The attribute `type`, such as `revolute`.
    pub kind: String,
    pub parent_link: String,
    pub child_link: String,
    pub origin_xyz_m: [f64; 3],
    pub origin_rpy_rad: [f64; 3],
    pub axis: [f64; 3],
    pub limit: Limit,
    /// The joint that this one follows.
    pub mimics: Option<String>,
}

/// Limits of a revolute joint.
pub(crate) struct Limit {
    pub lower_rad: f64,
    pub upper_rad: f64,
    pub velocity_rad_per_s: f64,
}

/// Reads a description.
pub(crate) fn read(xml: &str) -> Result<Robot, ChainError> {
    let options = ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, ..ParsingOptions::default() };
    let document = Document::parse_with_options(xml, options).map_err(ChainError::Parse)?;
    let robot = document.root_element();
    if robot.tag_name().name() != "robot" {
        return Err(ChainError::Root { found: robot.tag_name().name().into() });
    }
    let version = version(robot);
    Ok(Robot {
        name: robot.attribute("name").unwrap_or_default().into(),
        links: items(robot, "link").map(|link| link.text("name", "a name")).collect::<Result<_, _>>()?,
        joints: items(robot, "joint").map(|joint| read_joint(&joint, version)).collect::<Result<_, _>>()?,
    })
}

/// Major and minor version of the format; 1.0 if it is missing or unreadable, as in urdfdom.
fn version(robot: Node<'_, '_>) -> (u32, u32) {
    let parts = robot.attribute("version").and_then(|version| version.trim().split_once('.'));
    let numbers = parts.and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)));
    numbers.unwrap_or((1, 0))
}

fn read_joint(joint: &Element<'_, '_>, version: (u32, u32)) -> Result<Joint, ChainError> {
    let (origin, axis, mimic) = (joint.child("origin")?, joint.child("axis")?, joint.child("mimic")?);
    if let Some(origin) = &origin
        && version >= (1, 1)
        && origin.node.has_attribute("quat_xyzw")
    {
        return Err(origin.unreadable("quat_xyzw", "the orientation as attribute `rpy`: roll, pitch, yaw in rad"));
    }
    let three = |element: &Option<Element<'_, '_>>, attribute, default| match element {
        Some(element) => element.numbers(attribute, default, "three numbers separated by spaces, such as `0 0 1`"),
        None => Ok(default.unwrap_or_default()),
    };
    Ok(Joint {
        name: joint.text("name", "a name")?,
        kind: joint.text("type", "`revolute` or `fixed`")?,
        parent_link: joint.required_child("parent")?.text("link", "the name of a link")?,
        child_link: joint.required_child("child")?.text("link", "the name of a link")?,
        origin_xyz_m: three(&origin, "xyz", Some([0.0; 3]))?,
        origin_rpy_rad: three(&origin, "rpy", Some([0.0; 3]))?,
        axis: if axis.is_some() { three(&axis, "xyz", None)? } else { [1.0, 0.0, 0.0] },
        limit: read_limit(joint.child("limit")?, version)?,
        mimics: mimic.map(|mimic| mimic.text("joint", "the name of a joint")).transpose()?,
    })
}

/// Without the element, all limits are 0, and a caller that needs limits refuses them.
fn read_limit(limit: Option<Element<'_, '_>>, version: (u32, u32)) -> Result<Limit, ChainError> {
    let Some(limit) = limit else {
        return Ok(Limit { lower_rad: 0.0, upper_rad: 0.0, velocity_rad_per_s: 0.0 });
    };
    // From version 1.2 on a missing number means "no limit".
    let (lower, upper, velocity) = match version >= (1, 2) {
        true => (f64::NEG_INFINITY, f64::INFINITY, Some(f64::INFINITY)),
        false => (0.0, 0.0, None),
    };
    let one = |attribute, default: Option<f64>| {
        let [number] = limit.numbers(attribute, default.map(|number| [number]), "one number, such as `1.5`")?;
        Ok(number)
    };
    Ok(Limit {
        lower_rad: one("lower", Some(lower))?,
        upper_rad: one("upper", Some(upper))?,
        velocity_rad_per_s: one("velocity", velocity)?,
    })
}

/// An element, and the link or joint that messages name.
struct Element<'a, 'xml> {
    node: Node<'a, 'xml>,
    owner: String,
}

/// The robot's elements of one name. An element of another namespace has another name.
fn items<'a, 'xml>(robot: Node<'a, 'xml>, name: &'static str) -> impl Iterator<Item = Element<'a, 'xml>> {
    children(robot, name).enumerate().map(move |(index, node)| {
        let owner = match node.attribute("name") {
            Some(own) => format!("{name} `{own}`"),
            None => format!("{name} number {} of the file", index + 1),
        };
        Element { node, owner }
    })
}

fn children<'a, 'xml>(parent: Node<'a, 'xml>, name: &'static str) -> impl Iterator<Item = Node<'a, 'xml>> {
    let namespace = parent.tag_name().namespace();
    parent.children().filter(move |child| {
        child.is_element() && child.tag_name().name() == name && child.tag_name().namespace() == namespace
    })
}

impl<'a, 'xml> Element<'a, 'xml> {
    /// The child element of this name, if any; an error if it is repeated.
    fn child(&self, name: &'static str) -> Result<Option<Self>, ChainError> {
        let mut found = children(self.node, name);
        let first = found.next().map(|node| Self { node, owner: self.owner.clone() });
        match found.count() {
            0 => Ok(first),
            others => Err(ChainError::Element { owner: self.owner.clone(), element: name, count: 1 + others }),
        }
    }

    fn required_child(&self, name: &'static str) -> Result<Self, ChainError> {
        self.child(name)?.ok_or_else(|| ChainError::Element { owner: self.owner.clone(), element: name, count: 0 })
    }

    fn text(&self, attribute: &'static str, expected: &'static str) -> Result<String, ChainError> {
        self.node.attribute(attribute).map(str::to_owned).ok_or_else(|| self.unreadable(attribute, expected))
    }

    fn numbers<const N: usize>(
        &self,
        attribute: &'static str,
        default: Option<[f64; N]>,
        expected: &'static str,
    ) -> Result<[f64; N], ChainError> {
        let numbers = match self.node.attribute(attribute) {
            Some(text) => parse_numbers(text),
            None => default,
        };
        numbers.ok_or_else(|| self.unreadable(attribute, expected))
    }

    fn unreadable(&self, attribute: &'static str, expected: &'static str) -> ChainError {
        ChainError::Attribute {
            owner: self.owner.clone(),
            element: self.node.tag_name().name().into(),
            attribute,
            value: self.node.attribute(attribute).map(|value| value.chars().take(SHOWN_MAX).collect()),
            expected,
        }
    }
}

/// Exactly N numbers, separated by spaces.
fn parse_numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    let mut words = text.split_whitespace();
    for number in &mut numbers {
        *number = words.next()?.parse().ok()?;
    }
    words.next().is_none().then_some(numbers)
}
