#ifndef JAXTUBE_NAV2_CONTROLLER__TUBE_MPC_CONTROLLER_HPP_
#define JAXTUBE_NAV2_CONTROLLER__TUBE_MPC_CONTROLLER_HPP_

#include <memory>
#include <string>

#include "nav2_core/controller.hpp"
#include "rclcpp/rclcpp.hpp"

extern "C" {
#include "controller.h"  // whose constants are C, too
}

namespace jaxtube_nav2_controller
{

/// Tracks the reference that a jaxtube controller was exported for, where the plan of Nav2 is that
/// reference. The controller server must run at the period of the controller.
class TubeMpcController : public nav2_core::Controller
{
public:
  void configure(
    const rclcpp_lifecycle::LifecycleNode::WeakPtr & parent, std::string name,
    std::shared_ptr<tf2_ros::Buffer> tf,
    std::shared_ptr<nav2_costmap_2d::Costmap2DROS> costmap_ros) override;
  void cleanup() override {}
  void activate() override {}
  void deactivate() override {}

  /// Place the reference at the first pose of the plan, and begin it; the plan that is driven goes
  /// on, and no other one is taken before it is driven.
  void setPlan(const nav_msgs::msg::Path & path) override;

  /// Throws nav2_core::NoValidControl where the plan is not the reference, or the controller has
  /// halted.
  geometry_msgs::msg::TwistStamped computeVelocityCommands(
    const geometry_msgs::msg::PoseStamped & pose, const geometry_msgs::msg::Twist & velocity,
    nav2_core::GoalChecker * goal_checker) override;

  /// The speeds are those that the design is certified for: a limit is refused, in the log.
  void setSpeedLimit(const double & speed_limit, const bool & percentage) override;

private:
  struct Pose
  {
    double x;
    double y;
    double heading;
  };

  static Pose read(const geometry_msgs::msg::Pose & pose);
  static Pose see(const Pose & pose, const Pose & origin);
  double find_farthest(const nav_msgs::msg::Path & path) const;

  rclcpp::Logger logger_{rclcpp::get_logger("jaxtube")};
  rclcpp::Clock::SharedPtr clock_;
  jaxtube_controller controller_{};
  Pose origin_{};
  nav_msgs::msg::Path plan_;
  bool drives_{false};
  double wheel_separation_{0.0};
  double path_tolerance_{0.05};
  bool has_plan_{false};
};

}  // namespace jaxtube_nav2_controller

#endif  // JAXTUBE_NAV2_CONTROLLER__TUBE_MPC_CONTROLLER_HPP_
