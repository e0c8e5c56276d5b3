// @ts-check
// Types of the messages: docs/reference/panel-api.md.

/** @typedef {[number, number]} Pixel */
/** @typedef {{number: number, name: string, is_moving: boolean, is_latched: boolean, is_ready: boolean, may: string[]}} SupervisorState */
/** @typedef {{name: string, since_ms: number, clears_ms: number|null, action: string}} Inhibit */
/**
 * @typedef {object} TargetState
 * @property {number|null} id
 * @property {string|null} name
 * @property {number|null} sequence
 * @property {string} status
 * @property {string} reason
 * @property {number|null} age_ms
 * @property {number|null} latency_ms
 * @property {number|null} fitness
 * @property {Pixel[]} outline_px
 * @property {Pixel[]} outline_right_px
 * @property {Pixel[]|null} axes_px
 * @property {Pixel[]|null} axes_right_px
 * @property {number[]|null} point_mm
 * @property {number[]|null} world_from_model
 * @property {number[]|null} sigma_mm
 * @property {number[]|null} sigma_deg
 * @property {number[]|null} motion_sigma_mm
 * @property {number[]|null} motion_sigma_deg
 * @property {number|null} surface_version
 * @property {number|null} realign_mm
 * @property {number|null} realign_deg
 * @property {number[]|null} error_mm
 * @property {number[]|null} error_deg
 */
/** @typedef {{name: string, condition: string, position_deg: number[], speed_deg_per_s: number[], near: number[]}} ArmState */
/**
 * @typedef {object} State
 * @property {number} time_ms
 * @property {number} realtime_factor
 * @property {SupervisorState} state
 * @property {{line: string, code: string|null, inhibits: Inhibit[]}} why
 * @property {{holder: {id: number, name: string}|null, heard_ms_ago: number|null, trouble: string|null}} operator
 * @property {TargetState} target
 * @property {string[]} saved
 * @property {{error_mm: number|null, error_deg: number|null, speed_percent: number, jog: {offset_mm: number[], offset_deg: number[]}}} control
 * @property {ArmState[]} arms
 * @property {{world_from_target: number[]}|null} truth
 * @property {{sequence: number|null, fps: number, lost: number}} images
 */
/** @typedef {{mechanical_deg: number[], servo_deg: number[], operating_deg: number[], gateway_deg: number[]|null, drive_speed_deg_per_s: number, speed_deg_per_s: number, gateway_speed_deg_per_s: number|null}} JointLimit */
/**
 * @typedef {object} ArmInfo
 * @property {string} name
 * @property {number} joints
 * @property {JointLimit[]} limits
 * @property {number[]} world_from_base
 * @property {number[][]} chain
 * @property {number[][]} axis
 * @property {number[]} flange_from_tool
 */
/** @typedef {{table: string, source: string, date: string|null, gates: {name: string, measured: number, good: number, refused: number, grade: string}[]}} Calibration */
/**
 * @typedef {object} Info
 * @property {string} version
 * @property {string} setup
 * @property {boolean} emulated
 * @property {boolean} simulated
 * @property {boolean} playground
 * @property {boolean} hold_to_run
 * @property {number} silent_after_ms
 * @property {{size_px: Pixel, calibrated: boolean, calibration: string, calibrations: Calibration[], left: {focal_px: Pixel}, cam_right_from_cam_left: number[]}} cameras
 * @property {ArmInfo[]} arms
 * @property {number[]|null} hand_from_cam_left
 */
/**
 * @typedef {object} Preview
 * @property {boolean} will_work
 * @property {string} why
 * @property {string} status
 * @property {Pixel[]} outline_px
 * @property {Pixel[]} outline_right_px
 * @property {Pixel[]|null} axes_px
 * @property {number|null} depth_mm
 * @property {number[]|null} sigma_mm
 * @property {number[]|null} sigma_deg
 * @property {number} ms
 * @property {number} sequence
 */
/**
 * @typedef {object} Control
 * @property {number} id
 * @property {string} name
 * @property {"integer"|"boolean"|"menu"|"bitmask"|"button"|"other"} kind
 * @property {number} min
 * @property {number} max
 * @property {number} step
 * @property {number} default
 * @property {number|null} value
 * @property {{name: string, factor: number}|null} unit
 * @property {"auto"|"manual"|null} mode
 * @property {boolean} is_locked
 * @property {boolean} moves_the_lens
 * @property {{value: number, text: string}[]} menu
 */
/** @typedef {{name: string, controls: Control[], losses: Record<string, number>}} Camera */
/** @typedef {{may_change: boolean, why_not: string|null, problem: string|null, cameras: Camera[], line: string|null}} Controls */
/** @typedef {{check: string, passed: boolean|null, value: number|null, unit: string, limit_min: number|null, limit_max: number|null, found: string, advice: string|null}} Finding */
/** @typedef {{sequence: number, time_ms: number, skew_ms: number, skew_worst_ms: number, findings: Finding[]}} CameraCheck */
/** @typedef {{side: 0|1, isHeat: boolean, isRectified: boolean, sequence: number, time_ms: number, size_px: Pixel, place_px: Pixel, bitmap: ImageBitmap}} CameraImage */
/** @typedef {{time_ms: number, level: string, text: string, code: string|null}} LogLine */
/** @typedef {{ok: boolean, status: number, body: any}} Answer */

export {};
