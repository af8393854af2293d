#include "jaxtube_nav2_controller/tube_mpc_controller.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "nav2_core/controller_exceptions.hpp"
#include "nav2_util/node_utils.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace jaxtube_nav2_controller
{

void TubeMpcController::configure(
  const rclcpp_lifecycle::LifecycleNode::WeakPtr & parent, std::string name,
  std::shared_ptr<tf2_ros::Buffer>, std::shared_ptr<nav2_costmap_2d::Costmap2DROS>)
{
  const auto node = parent.lock();
  if (!node) {
    throw nav2_core::InvalidController("the node is gone");
  }
  logger_ = node->get_logger();
  clock_ = node->get_clock();
  const auto separation = name + ".wheel_separation_m";
  const auto tolerance = name + ".path_tolerance_m";
  nav2_util::declare_parameter_if_not_declared(node, separation, rclcpp::ParameterValue(0.0));
  nav2_util::declare_parameter_if_not_declared(node, tolerance, rclcpp::ParameterValue(0.05));
  node->get_parameter(separation, wheel_separation_);
  node->get_parameter(tolerance, path_tolerance_);
  if (!(wheel_separation_ > 0.0)) {
    throw nav2_core::InvalidController(separation + ": give metres, such as 0.5");
  }
  if (JAXTUBE_NEEDS_SLIP) {
    throw nav2_core::InvalidController("the controller needs measured slips, which Nav2 has not");
  }
  if (jaxtube_begin(&controller_, 0) != 0) {
    throw nav2_core::InvalidController("the constants are damaged; export the controller again");
  }
}

TubeMpcController::Pose TubeMpcController::read(const geometry_msgs::msg::Pose & pose)
{
  const auto & q = pose.orientation;
  const double heading =
    std::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
  return {pose.position.x, pose.position.y, heading};
}

TubeMpcController::Pose TubeMpcController::see(const Pose & pose, const Pose & origin)
{
  const double cosine = std::cos(origin.heading);
  const double sine = std::sin(origin.heading);
  const double x = pose.x - origin.x;
  const double y = pose.y - origin.y;
  return {cosine * x + sine * y, cosine * y - sine * x, pose.heading - origin.heading};
}

namespace
{

/// The distance of a point from the line between two poses of the reference.
double measure_distance(double x, double y, const double * begin, const double * end)
{
  const double along_x = end[0] - begin[0];
  const double along_y = end[1] - begin[1];
  const double length = along_x * along_x + along_y * along_y;
  const double ahead = (x - begin[0]) * along_x + (y - begin[1]) * along_y;
  const double share = length > 0.0 ? std::clamp(ahead / length, 0.0, 1.0) : 0.0;
  return std::hypot(x - begin[0] - share * along_x, y - begin[1] - share * along_y);
}

bool is_same(const nav_msgs::msg::Path & one, const nav_msgs::msg::Path & other)
{
  const auto are_equal = [](const auto & a, const auto & b) {
      const auto & p = a.pose.position;
      const auto & q = b.pose.position;
      return p.x == q.x && p.y == q.y;
    };
  return one.header.frame_id == other.header.frame_id &&
         std::equal(
    one.poses.begin(), one.poses.end(), other.poses.begin(), other.poses.end(), are_equal);
}

}  // namespace

double TubeMpcController::find_farthest(const nav_msgs::msg::Path & path) const
{
  double farthest = 0.0;
  for (const auto & posed : path.poses) {
    const Pose pose = see(read(posed.pose), origin_);
    double nearest = std::numeric_limits<double>::infinity();
    for (int i = 0; i < JAXTUBE_STEPS; i++) {
      const double * begin = jaxtube_references[i].pose;
      const double * end = jaxtube_references[i + 1].pose;
      nearest = std::min(nearest, measure_distance(pose.x, pose.y, begin, end));
    }
    farthest = std::max(farthest, nearest);
  }
  return farthest;
}

void TubeMpcController::setPlan(const nav_msgs::msg::Path & path)
{
  if (path.poses.empty() || (has_plan_ && is_same(path, plan_))) {
    return;
  }
  if (drives_) {
    RCLCPP_ERROR(logger_, "another plan comes while one is driven: it is not taken");
    return;
  }
  has_plan_ = false;
  // The frame in which the reference begins at the first pose of the plan.
  const Pose first = read(path.poses.front().pose);
  const double * begin = jaxtube_references[0].pose;
  const double turn = first.heading - begin[2];
  origin_ = {
    first.x - std::cos(turn) * begin[0] + std::sin(turn) * begin[1],
    first.y - std::sin(turn) * begin[0] - std::cos(turn) * begin[1], turn};
  const double farthest = find_farthest(path);
  if (!(farthest <= path_tolerance_)) {
    RCLCPP_ERROR(
      logger_, "the plan leaves the reference of the controller by %.3g m; export one for it",
      farthest);
    return;
  }
  jaxtube_restart(&controller_, 0);
  plan_ = path;
  has_plan_ = true;
}

geometry_msgs::msg::TwistStamped TubeMpcController::computeVelocityCommands(
  const geometry_msgs::msg::PoseStamped & pose, const geometry_msgs::msg::Twist &,
  nav2_core::GoalChecker *)
{
  if (!has_plan_) {
    throw nav2_core::NoValidControl("the plan is not the reference of the controller");
  }
  if (pose.header.frame_id != plan_.header.frame_id) {
    throw nav2_core::NoValidControl("poses are not in the frame of the plan");
  }
  const rclcpp::Time now = clock_->now();
  const Pose seen = see(read(pose.pose), origin_);
  jaxtube_input input{};
  jaxtube_output output{};
  input.pose[0] = seen.x;
  input.pose[1] = seen.y;
  input.pose[2] = seen.heading;
  input.stamp_s = rclcpp::Time(pose.header.stamp).seconds();
  input.now_s = now.seconds();
  input.has_pose = 1;
  input.has_times = 1;
  const int status = jaxtube_step(&controller_, &input, &output);
  drives_ = status != JAXTUBE_HALTED && status != JAXTUBE_FINISHED;
  has_plan_ = drives_;
  if (status == JAXTUBE_HALTED) {
    throw nav2_core::NoValidControl("halted: no pose could be used for too long");
  }
  if (!output.guaranteed) {
    RCLCPP_WARN(logger_, "no guarantee: status %d, pose %d", status, output.pose);
  }
  geometry_msgs::msg::TwistStamped twist;
  twist.header.stamp = now;
  twist.header.frame_id = "base_link";
  twist.twist.linear.x = (output.wheels[0] + output.wheels[1]) / 2.0;
  twist.twist.angular.z = (output.wheels[0] - output.wheels[1]) / wheel_separation_;
  return twist;
}

void TubeMpcController::setSpeedLimit(const double &, const bool &)
{
  RCLCPP_WARN(logger_, "speed limits are not followed: the design is certified for its speeds");
}

}  // namespace jaxtube_nav2_controller

PLUGINLIB_EXPORT_CLASS(jaxtube_nav2_controller::TubeMpcController, nav2_core::Controller)
