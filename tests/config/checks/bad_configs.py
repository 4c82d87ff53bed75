"""The table of `test_bad_configs`: what is wrong, and exactly what is said about it.

Each case breaks one line of `conftest.GOOD`, or gives overrides, or both. {tasks}, {rewards} and
{classes} stand for the names that exist, {cwd} for the working directory; a report that ends in
... goes on.
"""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bad:
    """One bad config.

    Attributes:
        old: What is replaced in the good task...
        new: ...by this.
        overrides: Given besides ``task=mine``.
        says: The whole report, one line a mistake.
        verb: ``run`` or ``train``.
        task: What is chosen; None chooses nothing.
    """

    says: tuple[str, ...]
    old: str = ""
    new: str = ""
    overrides: tuple[str, ...] = ()
    verb: str = "run"
    task: str | None = "mine"


def bad(*says: str, **kwargs: Any) -> Bad:
    """What is said, and the fields of `Bad`."""
    return Bad(says, **kwargs)


BAD = {
    "unknown key in a task": bad(
        "conf/task/mine.yaml:3: task.max_episode_step: unknown key; allowed: "
        "sim_steps_per_control, ignore_terminations, max_episode_steps, description, id, "
        "physics, decimation, episode_length_s, robot, robots, objects, articulations, "
        "lights, scene, views, sensors, actions, events, commands, observations, "
        "enable_corruption, rewards, reward_floor, terminations, metrics, symmetry, curriculum, "
        "expert, extensions, suggested. Did you mean 'max_episode_steps'?",
        old="max_episode_steps: 50",
        new="max_episode_step: 50",
    ),
    "unknown key in a robot": bad(
        "conf/task/mine.yaml:7: task.robot.init_qps: unknown key; allowed: uid, "
        "init_pos, init_rot, init_local_pose, fpath, drive_pros, body_scale, "
        "attrs, fix_base, disable_self_collision, init_qpos, sleep_threshold, "
        "min_position_iters, min_velocity_iters, build_pk_chain, compute_uv, "
        "use_usd_properties, control_parts, urdf_cfg, solver_cfg, init_quat, attachments, "
        "gravcomp, collision, collision_shapes, locked_joints, contact, self_collision, names, "
        "marks, attach, grippers, home. Did you mean 'init_qpos'?",
        old="  init_qpos: [0",
        new="  init_qps: [0",
    ),
    "unknown key in a shape": bad(
        "conf/task/mine.yaml:9: task.objects.ball.shape.size: unknown key; allowed: "
        "shape_type, visual_material, radius, resolution.",
        old="radius: 0.05",
        new="radius: 0.05, size: [1, 1, 1]",
    ),
    "unknown key in a term": bad(
        "conf/task/mine.yaml:21: task.events.move.interval_steps: unknown key; allowed: "
        "func, params, mode, interval_step, interval_range_s, is_global, strength. "
        "Did you mean 'interval_step'?",
        old="    interval_step: 5",
        new="    interval_steps: 5",
    ),
    "unknown key at the root": bad(
        "command line: num_env: unknown key; allowed: task, sim, record, viewer, algo, "
        "num_envs, seed, device, episodes, max_steps, total_timesteps, policy, "
        "allow_changed, trust, dataset, resume, collect, checkpoint, eval, wandb, video, "
        "scene_png, "
        "gym_config, output_dir, quiet, json, traceback. Did "
        "you mean 'num_envs'?",
        overrides=("num_env=4",),
    ),
    "a task's key at the root": bad(
        "command line: rewards: unknown key; allowed: task, sim, record, viewer, algo, "
        "num_envs, seed, device, episodes, max_steps, total_timesteps, policy, "
        "allow_changed, trust, dataset, resume, collect, checkpoint, eval, wandb, video, "
        "scene_png, "
        "gym_config, output_dir, quiet, json, traceback. Did "
        "you mean 'task.rewards'?",
        overrides=("rewards.near.weight=2",),
    ),
    "a root key in a task": bad(
        "conf/task/mine.yaml:1: task.num_envs: not a key of a task; it is a key of the "
        "root: num_envs=N",
        old="description: A small task.",
        new="num_envs: 4",
    ),
    "simulation config in a task": bad(
        "command line: task.sim_cfg: not a key of a task; use task.physics for the "
        "physics and the group sim for how it runs",
        overrides=("+task.sim_cfg.physics_dt=0.01",),
    ),
    "text for an integer": bad(
        "command line: num_envs: expected an integer, got 'four'",
        overrides=("num_envs=four",),
    ),
    "a fraction for an integer": bad(
        "conf/task/mine.yaml:3: task.max_episode_steps: expected an integer, got 50.5",
        old="max_episode_steps: 50",
        new="max_episode_steps: 50.5",
    ),
    "text for a number": bad(
        "conf/task/mine.yaml:26: task.rewards.near.weight: expected a number, got 'heavy'",
        old="    weight: 0.5",
        new="    weight: heavy",
    ),
    "a number for a map": bad(
        "command line: task.objects.box: expected a map, got 3",
        overrides=("task.objects.box=3",),
    ),
    "a number for a list": bad(
        "conf/task/mine.yaml:14: task.objects.box.init_pos: expected a list, got 3",
        old="    init_pos: [0.5, 0, 0.05]",
        new="    init_pos: 3",
    ),
    "a list for a map": bad(
        "conf/task/mine.yaml:7: task.robot.control_parts: expected a map, got ['a', 'b']",
        old="  init_qpos: [0, -1, 1, 0, 0, 0]",
        new="  control_parts: [a, b]",
    ),
    "text in a list of numbers": bad(
        "conf/task/mine.yaml:13: task.objects.box.shape.size.1: expected a number, got 'wide'",
        old="      size: [0.1, 0.1, 0.1]",
        new="      size: [0.1, wide, 0.1]",
    ),
    "neither number nor map": bad(
        "command line: task.robot.drive_pros.stiffness: expected a number or a map or 'file', "
        "got 'stiff'",
        overrides=("task.robot.drive_pros.stiffness=stiff",),
    ),
    "neither number, map nor file": bad(
        "command line: task.robot.drive_pros.max_effort: expected a number or a map or "
        "'file', got 'fil'. Did you mean 'file'?",
        overrides=("task.robot.drive_pros.max_effort=fil",),
    ),
    "wrong type in a map of joints": bad(
        "command line: task.robot.drive_pros.damping.Joint1: expected a number, got 'soft'",
        overrides=("task.robot.drive_pros.damping.Joint1=soft",),
    ),
    "a string for a switch": bad(
        "command line: quiet: expected true or false, got 1",
        overrides=(
            "record=none",
            "quiet=1",
        ),
    ),
    "list too short": bad(
        "conf/task/mine.yaml:14: task.objects.box.init_pos: expected 3 values, got 2: [0.5, 0]",
        old="    init_pos: [0.5, 0, 0.05]",
        new="    init_pos: [0.5, 0]",
    ),
    "list too long": bad(
        "conf/task/mine.yaml:13: task.objects.box.shape.size: expected 3 values, got 4: "
        "[0.1, 0.1, 0.1, 1]",
        old="      size: [0.1, 0.1, 0.1]",
        new="      size: [0.1, 0.1, 0.1, 1]",
    ),
    "wrong choice": bad(
        "conf/task/mine.yaml:20: task.events.move.mode: expected one of 'startup', "
        "'reset', 'interval', got 'intervall'. Did you mean 'interval'?",
        old="    mode: interval",
        new="    mode: intervall",
    ),
    "wrong choice in a group": bad(
        "command line: record.compression: expected one of 'zstd', 'lz4', 'none', got "
        "'zst'. Did you mean 'zstd'?",
        overrides=("record.compression=zst",),
    ),
    "unknown shape": bad(
        "conf/task/mine.yaml:12: task.objects.box.shape.shape_type: unknown shape "
        "'Kube'; one of: Cube, Sphere, Cylinder, Capsule, Plane, Mesh. Did you mean "
        "'Cube'?",
        old="      shape_type: Cube",
        new="      shape_type: Kube",
    ),
    "no shape_type": bad(
        "conf/task/mine.yaml:11: task.objects.box.shape.shape_type: missing value; one "
        "of: Cube, Sphere, Cylinder, Capsule, Plane, Mesh",
        old="      shape_type: Cube\n",
    ),
    "too small": bad(
        "command line: num_envs: must be at least 1, got 0",
        overrides=("num_envs=0",),
    ),
    "not positive": bad(
        "conf/task/mine.yaml:2: task.physics.physics_dt: must be greater than 0.0, got 0",
        old="physics_dt: 0.005",
        new="physics_dt: 0",
    ),
    "no such time limit": bad(
        "conf/task/mine.yaml:3: task.max_episode_steps: must be at least 1, or -1 for no "
        "limit, got 0",
        old="max_episode_steps: 50",
        new="max_episode_steps: 0",
    ),
    "negative episode count": bad(
        "command line: episodes: must be at least 1, got -1",
        overrides=("episodes=-1",),
    ),
    "out of range in an algorithm": bad(
        "command line: algo.gamma: must be at most 1.0, got 1.5",
        overrides=(
            "algo.gamma=1.5",
            "total_timesteps=1000",
        ),
        verb="train",
    ),
    "unknown argument of an algorithm": bad(
        "command line: algo.learning_rte: unknown key; allowed: name, policy, "
        "learning_rate, critic_groups, symmetric, policy_kwargs, normalize, normalize_kwargs, "
        "n_steps, gamma, gae_lambda, normalize_advantage, use_sde, sde_sample_freq, "
        "stats_window_size, batch_size, n_epochs, clip_range, clip_range_vf, ent_coef, vf_coef, "
        "max_grad_norm, target_kl. Did you mean 'learning_rate'?",
        overrides=(
            "algo.learning_rte=0.1",
            "total_timesteps=1000",
        ),
        verb="train",
    ),
    "an algorithm's key of rl-zoo3": bad(
        "command line: algo.n_timesteps: not a key of an algorithm; it is a key of the root: "
        "total_timesteps=N",
        overrides=(
            "algo.n_timesteps=1000",
            "total_timesteps=1000",
        ),
        verb="train",
    ),
    "a schedule that is none": bad(
        "command line: algo.learning_rate: expected a number or a schedule lin_VALUE, "
        "got 'line_3e-4'",
        overrides=(
            "algo.learning_rate=line_3e-4",
            "total_timesteps=1000",
        ),
        verb="train",
    ),
    "unknown device": bad(
        "command line: device: unknown device 'gpu'; allowed: cpu, cuda, cuda:N. "
        "Did you mean 'cpu'?",
        overrides=("device=gpu",),
    ),
    "unavailable device": bad(
        "command line: device: there is no CUDA device here (sim.engine=warp device=cpu runs, "
        "slowly, without)",
        overrides=("device=cuda:0",),
    ),
    "an engine that does not run on the device": bad(
        "command line: device: sim.engine=mujoco does not run on 'cuda': device=cpu, or "
        "sim.engine=warp",
        overrides=("device=cuda", "sim.engine=mujoco"),
    ),
    "an engine that does not exist": bad(
        "command line: sim.engine: expected one of 'mujoco', 'warp', got 'mujco'. Did you mean "
        "'mujoco'?",
        overrides=("sim.engine=mujco",),
    ),
    "memory of an engine that is not used": bad(
        "command line: sim.warp.njmax: is for sim.engine=warp, but the engine is mujoco",
        overrides=("sim.warp.njmax=64",),
    ),
    "a solver that MuJoCo Warp has not": bad(
        "command line: task.physics.solver: MuJoCo Warp has no mjSOL_PGS; it has cg, newton",
        overrides=("sim.engine=warp", "+task.physics.solver=PGS"),
    ),
    "keyframes of physics that is not repeated": bad(
        "command line: record.state: physics of sim.engine=warp is not repeated to the bit; "
        "use record.state=all",
        overrides=("sim.engine=warp", "record.state=keyframes"),
    ),
    "unknown policy": bad(
        "command line: policy: unknown policy 'randon'; allowed: expert, hold, random, "
        "random_around_home, teleop, zero, last, pretrained, package.module:function, or a path. "
        "Did you mean 'random'?",
        overrides=("policy=randon",),
    ),
    "teleoperation without a viewer or a tool": bad(
        "command line: policy: teleop needs a viewer: viewer=web or viewer=native, not foxglove",
        "command line: num_envs: policy: teleop moves one robot; set num_envs=1, not 2",
        "command line: policy: teleop moves a tool: the task needs an action eef_delta_pose, "
        "eef_pose or operational_space; its actions are arm: joint_position",
        overrides=("policy=teleop", "viewer=foxglove", "num_envs=2"),
    ),
    "teleoperation with the task's number of environments": bad(
        "command line: policy: teleop needs a viewer: viewer=web or viewer=native, not none",
        old="actions:\n  arm: {func: joint_position",
        new="actions:\n  tool: {func: eef_delta_pose",
        overrides=("policy={func: teleop, params: {linear_speed: 0.1}}",),
    ),
    "wrong parameter of a policy": bad(
        "command line: policy.params.rnge: unknown parameter of policy "
        "'random_around_home'; it takes range. Did you mean 'range'?",
        overrides=("policy={func: random_around_home, params: {rnge: 1}}",),
    ),
    "no policy file": bad(
        "command line: policy: no such file or folder: runs/old.zip",
        overrides=("policy=runs/old.zip",),
    ),
    "a film of nothing": bad(
        "command line: video: films are made from the log: they need record=mcap with "
        "record.state=all",
        overrides=("video=true", "record=none"),
    ),
    "wrong command": bad(
        "command line: task.commands.there.resampling_time_s: needs 0 < low <= high, got "
        "[2.0, 1.0]",
        "command line: task.commands.go.func: unknown command term 'uniform_velocty'; allowed: "
        "uniform_joint_position, uniform_pose, uniform_velocity, or package.module:function. "
        "Did you mean 'uniform_velocity'?",
        "command line: task.commands.there.params.position_range: missing; command term "
        "'uniform_pose' needs it",
        "command line: task.observations.go.params.command_name: no command is called 'thre'; "
        "there are: go, there. Did you mean 'there'?",
        overrides=(
            "+task.commands.go={func: uniform_velocty}",
            "+task.commands.there={func: uniform_pose, resampling_time_s: [2, 1], "
            "params: {entity_cfg: {uid: arm}}}",
            "+task.observations.go={func: generated_command, params: {command_name: thre}}",
        ),
    ),
    "wrong curriculum": bad(
        "command line: task.curriculum.a.params.term_name: there is no 'neer' in rewards; there "
        "are: near. Did you mean 'near'?",
        "command line: task.curriculum.b.params.param: there is no 'treshold' in the parameters; "
        "there is: use_xy_only, source_entity_cfg, target_entity_cfg, threshold. "
        "Did you mean 'threshold'?",
        overrides=(
            "+task.curriculum.a={func: modify_reward_weight, params: {term_name: neer, weight: 2, "
            "num_steps: 5}}",
            "+task.curriculum.b={func: modify_term_param, params: {section: rewards, "
            "term_name: near, param: treshold, value: 1, num_steps: 5}}",
        ),
    ),
    "wrong noise, delay and history": bad(
        "command line: task.observations.a.noise.type: unknown type 'guassian'; one of: gaussian, "
        "uniform, constant. Did you mean 'gaussian'?",
        "command line: task.observations.b.noise.sdt: unknown key; allowed: type, operation, mean, "
        "std. Did you mean 'std'?",
        "command line: task.observations.c.noise.std: must not be negative, got -1.0",
        "command line: task.observations.c.delay: needs 0 <= low <= high, got [2, 1]",
        "command line: task.observations.d.history_length: must be at least 0, got -1",
        "command line: task.enable_corruption.polcy: no observation is in group 'polcy'; there "
        "are: policy. Did you mean 'policy'?",
        overrides=(
            "+task.observations.a={func: last_action, noise: {type: guassian, std: 1}}",
            "+task.observations.b={func: last_action, noise: {std: 1, sdt: 1}}",
            "+task.observations.c={func: last_action, noise: {std: -1.0}, delay: [2, 1]}",
            "+task.observations.d={func: last_action, history_length: -1}",
            "+task.enable_corruption={polcy: false}",
        ),
    ),
    "unknown sensor": bad(
        "command line: task.sensors.cam.sensor_type: unknown sensor 'camra'; one of: camera, "
        "stereo_camera, contact, force_torque, frame_pose, imu, joint_torque, ray, height_scan. "
        "Did you mean 'camera'?",
        "command line: task.sensors.lidar.pattern.fan.horizontal_cout: unknown key; allowed: "
        "horizontal_range, horizontal_count, vertical_range, vertical_count. Did you mean "
        "'horizontal_count'?",
        "command line: task.sensors.touch.agianst: unknown key; allowed: sensor_type, uid, "
        "of, observe, rate, against, history_length. Did you mean 'against'?",
        "command line: task.sensors.touch.entity_cfg.uid: no entity is called 'bal'; there are: "
        "arm, ball, box. Did you mean 'ball'?",
        overrides=(
            "+task.sensors.cam={sensor_type: camra, width: 64}",
            "+task.sensors.lidar={sensor_type: ray, pattern: {fan: {horizontal_cout: 3}}}",
            "+task.sensors.touch={sensor_type: contact, entity_cfg: {uid: bal}, agianst: {}}",
        ),
    ),
    "missing value": bad(
        "conf/task/mine.yaml:6: task.robot.fpath: missing value (???): it must be set",
        old="  fpath: UniversalRobots/UR10/UR10.urdf",
        new="  fpath: ???",
    ),
    "no task": bad(
        "command line: task: missing value: choose one with task=NAME; there are: {first_tasks}",
        task=None,
    ),
    "settings of a film": bad(
        "command line: video.size.0: expected a multiple of 2, got 161",
        "command line: video.every: must be at least 1, got 0",
        "command line: video.max_second: unknown key; allowed: size, every, max_seconds, "
        "format. Did you mean 'max_seconds'?",
        overrides=("video.size=[161,120]", "video.every=0", "video.max_second=3"),
    ),
    "a film that is a number": bad(
        "command line: video: expected true or false or a map, got 7",
        overrides=("video=7",),
    ),
    "no task, and more": bad(
        "command line: task: missing value: choose one with task=NAME; there are: {first_tasks}",
        "command line: episodes: must be at least 1, got 0",
        overrides=("episodes=0",),
        task=None,
    ),
    "an unknown task, and more": bad(
        "command line: task: unknown option 'mein'; task is one of: {tasks}. Did you mean 'mine'?",
        "command line: record: unknown option 'mcpa'; record is one of: mcap, none. Did "
        "you mean 'mcap'?",
        "command line: seed: expected an integer, got 'x'",
        "command line: episodes: must be at least 1, got 0",
        "command line: num_env: unknown key; allowed: task, sim, record, viewer, algo, "
        "num_envs, seed, device, episodes, max_steps, total_timesteps, policy, "
        "allow_changed, trust, dataset, resume, collect, checkpoint, eval, wandb, video, "
        "scene_png, "
        "gym_config, output_dir, quiet, json, traceback. Did "
        "you mean 'num_envs'?",
        task="mein",
        overrides=(
            "num_env=4",
            "seed=x",
            "record=mcpa",
            "episodes=0",
            "task.max_episode_steps=7",
            "~task.events.move",
        ),
    ),
    "malformed YAML, and more": bad(
        "conf/task/mine.yaml:6: malformed YAML: expected ',' or '}', but got ':' (while "
        "parsing a flow mapping)",
        "command line: num_envs: must be at least 1, got 0",
        old="robot:\n",
        new="robot: {\n",
        overrides=("num_envs=0",),
    ),
    "a seed that training cannot use": bad(
        "command line: seed: training needs a seed from 0 to 4294967295, got 4294967296",
        overrides=("seed=4294967296", "total_timesteps=1000"),
        verb="train",
    ),
    "a negative seed": bad(
        "command line: seed: must be at least 0, got -1",
        overrides=("seed=-1",),
    ),
    "no timesteps": bad(
        "command line: total_timesteps: missing value: set it, or "
        "task.suggested.train.total_timesteps",
        verb="train",
    ),
    "unknown task": bad(
        "command line: task: unknown option 'mein'; task is one of: {tasks}. Did you mean 'mine'?",
        task="mein",
    ),
    "unknown option of a group": bad(
        "command line: record: unknown option 'mcpa'; record is one of: mcap, none. Did "
        "you mean 'mcap'?",
        "command line: viewer: unknown option 'natve'; viewer is one of: foxglove, native, "
        "none, web. Did you mean 'native'?",
        overrides=(
            "record=mcpa",
            "viewer=natve",
        ),
    ),
    "malformed overrides": bad(
        "command line: malformed override 'num_envs': it has no =; expected "
        "key=value, +key=value or ~key",
        "command line: malformed override 'task.robot.init_qpos=[1,': it has a "
        "bracket without its other one; expected key=value, +key=value or ~key",
        overrides=(
            "num_envs",
            "task.robot.init_qpos=[1,",
        ),
    ),
    "a sweep without -m": bad(
        "command line: num_envs: 'num_envs=1,2' is a sweep: add -m to run every value, "
        "or write num_envs=[...] for a list",
        overrides=("num_envs=1,2",),
    ),
    "deleting what is not there": bad(
        "command line: task.events.mve: cannot delete it: there is no such key; there "
        "are: move. Did you mean 'move'?",
        overrides=("~task.events.mve",),
    ),
    "a misspelt term": bad(
        "command line: task.rewards.naer: there is no 'naer' in task.rewards; there are: "
        "near. Did you mean 'near'?",
        overrides=("task.rewards.naer.weight=2",),
    ),
    "a misspelt object": bad(
        "command line: task.objects.bax: there is no 'bax' in task.objects; there are: "
        "ball, box. Did you mean 'box'?",
        overrides=("task.objects.bax.init_pos=[0,0,1]",),
    ),
    "interpolation of nothing": bad(
        "conf/task/mine.yaml:1: task.description: cannot resolve '${task.nme}': "
        "Interpolation key 'task.nme' not found",
        old="description: A small task.",
        new="description: ${task.nme}",
    ),
    "no eval": bad(
        "conf/task/mine.yaml:26: task.rewards.near.weight: cannot resolve '${eval:1+1}': "
        "Unsupported interpolation type eval",
        old="    weight: 0.5",
        new="    weight: ${eval:1+1}",
    ),
    "no instantiation": bad(
        "conf/task/mine.yaml:25: task.rewards.near._target_: _target_ is not used here: "
        "name a function with func: NAME",
        "conf/task/mine.yaml:24: task.rewards.near.func: missing value: the name of a function",
        old="    func: within_distance",
        new="    _target_: os.system",
    ),
    "malformed YAML": bad(
        "conf/task/mine.yaml:6: malformed YAML: expected ',' or '}', but got ':' (while "
        "parsing a flow mapping)",
        old="robot:\n",
        new="robot: {\n",
    ),
    "a tag": bad(
        "conf/task/mine.yaml:1: malformed YAML: tags are not used here, found "
        "'tag:yaml.org,2002:python/name:os.system'",
        old="description: A small task.",
        new="description: !!python/name:os.system x",
    ),
    "the same key twice": bad(
        "conf/task/mine.yaml:10: malformed YAML: found duplicate key ball (while "
        "constructing a mapping)",
        old="  box:\n",
        new="  ball:\n",
    ),
    "suggested values": bad(
        "conf/task/mine.yaml:34: task.suggested.run.episode: unknown key; allowed: "
        "num_envs, seed, device, episodes, max_steps, total_timesteps, policy, video. "
        "Did you mean 'episodes'?",
        "conf/task/mine.yaml:34: task.suggested.run.num_envs: expected an integer, got 'two'",
        old="{num_envs: 2, episodes: 3}",
        new="{num_envs: two, episode: 3}",
    ),
    "unknown term": bad(
        "conf/task/mine.yaml:25: task.rewards.near.func: unknown reward term "
        "'within_distanc'; allowed: {rewards}, or "
        "package.module:function. Did you mean 'within_distance'?",
        old="    func: within_distance",
        new="    func: within_distanc",
    ),
    "term of another kind": bad(
        "conf/task/mine.yaml:25: task.rewards.near.func: 'last_action' is a term of kind "
        "observation, not reward",
        old="    func: within_distance",
        new="    func: last_action",
    ),
    "unknown module of a term": bad(
        "conf/task/mine.yaml:25: task.rewards.near.func: cannot import 'nowhere.at_all': "
        "No module named 'nowhere'",
        old="    func: within_distance",
        new="    func: nowhere.at_all:reward",
    ),
    "unknown parameter": bad(
        "conf/task/mine.yaml:30: task.rewards.near.params.treshold: unknown parameter of "
        "reward term 'within_distance'; it takes from, to, threshold, use_xy_only. Did you mean "
        "'threshold'?",
        "conf/task/mine.yaml:27: task.rewards.near.params.threshold: missing; reward "
        "term 'within_distance' needs it",
        "conf/task/mine.yaml:30: task.metrics.success.params.treshold: unknown parameter "
        "of metric term 'within_distance'; it takes from, to, threshold, use_xy_only. Did you mean "
        "'threshold'?",
        old="      threshold: 0.05",
        new="      treshold: 0.05",
    ),
    "missing parameter": bad(
        "conf/task/mine.yaml:27: task.rewards.near.params.threshold: missing; reward "
        "term 'within_distance' needs it",
        old="      threshold: 0.05\n",
    ),
    "wrong type of a parameter": bad(
        "conf/task/mine.yaml:30: task.rewards.near.params.threshold: expected a number, got 'near'",
        old="      threshold: 0.05",
        new="      threshold: near",
    ),
    "bad range of a parameter": bad(
        "conf/task/mine.yaml:30: task.rewards.near.params.threshold: must be "
        "greater than 0.0, got -1",
        old="      threshold: 0.05",
        new="      threshold: -1",
    ),
    "unknown entity": bad(
        "conf/task/mine.yaml:22: task.events.move.params.entity_cfg.uid: no entity is "
        "called 'bal'; there are: arm, ball, box. Did you mean 'ball'?",
        old="{uid: ball}",
        new="{uid: bal}",
    ),
    "unknown link": bad(
        "conf/task/mine.yaml:28: task.rewards.near.params.source_entity_cfg.link_names: "
        "no link of 'arm' matches 'ee_lnk'; there are: base_link, shoulder_link, "
        "upper_arm_link, forearm_link, wrist_1_link, wrist_2_link, wrist_3_link, "
        "ee_link. Did you mean 'ee_link'?",
        "conf/task/mine.yaml:28: "
        "task.metrics.success.params.source_entity_cfg.link_names: no link of 'arm' "
        "matches 'ee_lnk'; there are: base_link, shoulder_link, upper_arm_link, "
        "forearm_link, wrist_1_link, wrist_2_link, wrist_3_link, ee_link. Did you mean "
        "'ee_link'?",
        old="link_names: [ee_link]",
        new="link_names: [ee_lnk]",
    ),
    "unknown joint": bad(
        "conf/task/mine.yaml:16: task.actions.arm.params.entity_cfg.joint_names: no "
        "joint of 'arm' matches 'Joint9'; there are: Joint1, Joint2, Joint3, Joint4, "
        "Joint5, Joint6. Did you mean 'Joint1'?",
        old="params: {entity_cfg: {uid: arm}}",
        new="params: {entity_cfg: {uid: arm, joint_names: [Joint9]}}",
    ),
    "unknown joint of a drive": bad(
        "command line: task.robot.drive_pros.stiffness.Joitn1: no joint matches "
        "'Joitn1'; there are: Joint1, Joint2, Joint3, Joint4, Joint5, Joint6. Did you "
        "mean 'Joint1'?",
        overrides=("+task.robot.drive_pros.stiffness={Joitn1: 5}",),
    ),
    "unknown joint of a pose": bad(
        "conf/task/mine.yaml:7: task.robot.init_qpos.Joint0: no joint matches 'Joint0'; "
        "there are: Joint1, Joint2, Joint3, Joint4, Joint5, Joint6. Did you mean "
        "'Joint1'?",
        old="  init_qpos: [0, -1, 1, 0, 0, 0]",
        new="  init_qpos: {Joint0: 1}",
    ),
    "wrong number of joints": bad(
        "conf/task/mine.yaml:7: task.robot.init_qpos: must be 6 values, one for each joint "
        "(Joint1, Joint2, Joint3, Joint4, Joint5, Joint6), got 3",
        old="  init_qpos: [0, -1, 1, 0, 0, 0]",
        new="  init_qpos: [0, -1, 1]",
    ),
    "the same uid twice": bad(
        "conf/task/mine.yaml:10: task.objects.arm: uid 'arm' is taken by robot; every "
        "entity needs its own",
        old="  box:\n",
        new="  arm:\n",
    ),
    "missing file": bad(
        "conf/task/mine.yaml:6: task.robot.fpath: no file or folder for "
        "'UniversalRobots/UR10/UR11.urdf'. Searched...",
        old="UR10/UR10.urdf",
        new="UR10/UR11.urdf",
    ),
    "malformed URDF": bad(
        "conf/task/mine.yaml:6: task.robot.fpath: {cwd}/broken.urdf:1: not well-formed "
        "XML: mismatched tag",
        old="UniversalRobots/UR10/UR10.urdf",
        new="broken.urdf",
    ),
    "unknown control part": bad(
        "conf/task/mine.yaml:16: task.actions.arm.params.entity_cfg.control_parts: no "
        "control part of 'arm' matches 'hand'; there are: none",
        old="params: {entity_cfg: {uid: arm}}",
        new="params: {entity_cfg: {uid: arm, control_parts: hand}}",
    ),
    "a quaternion of zero": bad(
        "command line: task.objects.box.init_quat: a quaternion is zero or not finite; "
        "wxyz with unit length is wanted, got [0.0, 0.0, 0.0, 0.0]",
        overrides=("task.objects.box.init_quat=[0,0,0,0]",),
    ),
    "a shape without size": bad(
        "conf/task/mine.yaml:9: task.objects.ball.shape.radius: must be positive metres, got -0.05",
        old="radius: 0.05",
        new="radius: -0.05",
    ),
    "a shape beside any_of": bad(
        "conf/task/mine.yaml:11: task.objects.box.shape: the object has any_of: give each of its "
        "shapes there",
        overrides=("+task.objects.box.any_of.can.shape={shape_type: Cylinder}",),
    ),
    "shapes of any_of": bad(
        "conf/task/mine.yaml:9: task.objects.ball.any_of.can.shape.radius: must be positive "
        "metres, got 0.0",
        "conf/task/mine.yaml:9: task.objects.ball.any_of.plate.shape.fpath: a Mesh needs a file",
        "conf/task/mine.yaml:9: task.objects.ball.any_of.floor.body_type: a Plane must be static, "
        "got 'kinematic'",
        "conf/task/mine.yaml:9: task.objects.ball.any_of.can.quat: a quaternion is zero or not "
        "finite; wxyz with unit length is wanted, got [0.0, 0.0, 0.0, 0.0]",
        "conf/task/mine.yaml:9: task.objects.ball.any_of.a/b: uid 'a/b' must not contain '/', "
        "which separates it from its parts",
        old="shape: {shape_type: Sphere, radius: 0.05}",
        new="any_of: {plate: {shape: {shape_type: Mesh}}, floor: {shape: {shape_type: Plane}}, "
        "can: {quat: [0, 0, 0, 0], shape: {shape_type: Cylinder, radius: 0}}, a/b: {}}",
    ),
    "unknown key of a shape of any_of": bad(
        "conf/task/mine.yaml:9: task.objects.ball.any_of.can.masss: unknown key; allowed: shape, "
        "pos, rot, quat, mass, density, dynamic_friction, body_scale, max_convex_hull_num, "
        "collision. Did you mean 'mass'?",
        old="shape: {shape_type: Sphere, radius: 0.05}",
        new="any_of: {can: {masss: 1}}",
    ),
    "negative mass": bad(
        "command line: task.objects.box.attrs.mass: must be finite and not negative, got -1.0",
        overrides=("task.objects.box.attrs.mass=-1",),
    ),
    "infinite position": bad(
        "command line: task.robot.init_pos: must be 3 finite numbers, got [0.0, 0.0, inf]",
        overrides=("task.robot.init_pos=[0,0,inf]",),
    ),
    "several at once": bad(
        "command line: record: unknown option 'mcpa'; record is one of: mcap, none. Did "
        "you mean 'mcap'?",
        "command line: task.robot.foo: unknown key; allowed: uid, init_pos, init_rot, "
        "init_local_pose, fpath, drive_pros, body_scale, attrs, fix_base, "
        "disable_self_collision, init_qpos, sleep_threshold, min_position_iters, "
        "min_velocity_iters, build_pk_chain, compute_uv, use_usd_properties, control_parts, "
        "urdf_cfg, solver_cfg, init_quat, attachments, gravcomp, collision, "
        "collision_shapes, locked_joints, contact, self_collision, names, marks, attach, "
        "grippers, home.",
        "command line: task.objects.box.shape.size: expected 3 values, got 2: [1, 2]",
        "conf/task/mine.yaml:20: task.events.move.mode: expected one of 'startup', "
        "'reset', 'interval', got 'intervall'. Did you mean 'interval'?",
        "command line: num_envs: must be at least 1, got 0",
        "command line: device: unknown device 'gpu'; allowed: cpu, cuda, cuda:N. "
        "Did you mean 'cpu'?",
        "command line: task.rewards.near.func: unknown reward term 'within_distanc'; "
        "allowed: {rewards}, or "
        "package.module:function. Did you mean 'within_distance'?",
        "command line: task.actions.arm.params.entity_cfg.uid: no entity is called "
        "'amr'; there are: arm, ball, box. Did you mean 'arm'?",
        old="    mode: interval",
        new="    mode: intervall",
        overrides=(
            "num_envs=0",
            "record=mcpa",
            "task.objects.box.shape.size=[1,2]",
            "task.rewards.near.func=within_distanc",
            "task.actions.arm.params.entity_cfg.uid=amr",
            "device=gpu",
            "task.robot.foo=1",
        ),
    ),
    "a map for an integer": bad(
        "command line: num_envs: expected an integer, got {'x': 3}",
        overrides=("num_envs.x=3",),
    ),
    "a map for a uid": bad(
        "command line: task.robot.uid: expected text, got {'x': 3}",
        overrides=("task.robot.uid.x=3",),
    ),
    "null for an option": bad(
        "command line: viewer: unknown option 'null'; viewer is one of: foxglove, native, "
        "none, web.",
        overrides=("viewer=null",),
    ),
    "no key": bad(
        "command line: malformed override '=3': the key is missing; expected key=value, "
        "+key=value or ~key",
        overrides=("=3",),
    ),
    "one more of what is there": bad(
        "command line: sim: an option is chosen already: write sim=NAME, without +",
        overrides=("+sim=default",),
    ),
    "looking at environments that are not there": bad(
        "command line: record.view_envs: no such environments: [2, 9]; num_envs is 2",
        overrides=("record.view_envs=[0,2,9]",),
    ),
    "a viewer of an environment that is not there": bad(
        "command line: viewer.env: no such environment: 2; num_envs is 2",
        overrides=("viewer=web", "viewer.env=2"),
    ),
    "unknown class": bad(
        "conf/task/mine.yaml:1: task.id: no registered class 'NoSuchEnv-v0'; there are: {classes}.",
        old="description: A small task.",
        new="id: NoSuchEnv-v0",
    ),
}
